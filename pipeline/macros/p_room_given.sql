-- p_room_given(given, from_source, prior_weight, evidence_power, among):
-- rule pooled: the evidence Σ w(o) L′(o, r) of all the objects, and p(room), best first. A room of unknown
-- objects alone has one row without a room.
create macro p_room_given(
    given, from_source := null, prior_weight := null, evidence_power := null, among := null
) as table
with debiased as (
    select
        object,
        room,
        log_probability
        - coalesce(prior_weight, (select decision.prior_weight from decision)) * bias_nats
            as score
    from evidence
    where evidence.source = coalesce(from_source, (select decision.source from decision))
        and list_contains(known_objects(given), object)
        and (among is null or list_contains(among, room))
),

-- L′ = log softmax over the candidate rooms of L − λ b.
adjusted as (
    select
        object,
        room,
        log_softmax(score, list(score) over (partition by object)) as log_p
    from debiased
),

-- w = (log n − H′)^γ, H′ the entropy of L′; 0^0 is 1, as in the naive product.
weighed as (
    select
        room,
        log_p,
        power(
            greatest(
                ln(count(*) over of_object)
                + sum(case when exp(log_p) > 0 then exp(log_p) * log_p else 0 end) over of_object,
                0::double
            ),
            coalesce(evidence_power, (select decision.evidence_power from decision))
        ) as weight
    from adjusted
    window of_object as (partition by object)
),

-- An object without weight adds nothing, not 0 × −inf.
pooled as (
    select room, sum(case when weight > 0 then weight * log_p else 0 end) as evidence_nats
    from weighed
    group by room
)

select
    room,
    evidence_nats,
    exp(log_softmax(evidence_nats, list(evidence_nats) over ())) as p_room,
    unknown_objects(given) as unknown_objects
from pooled
union all
select null, null, null, unknown_objects(given)
where nothing_known(given)
order by evidence_nats desc, room
