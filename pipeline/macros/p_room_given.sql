-- p_room_given(given, from_source := 'proxy', prior_weight := 0.5, evidence_power := 3.0):
-- p(room | objects) by rule pooled, most probable room first.
create macro p_room_given(given, from_source := 'proxy', prior_weight := 0.5, evidence_power := 3.0)
as table
with known as (
    select object, room, log_probability - prior_weight * bias_nats as adjusted
    from evidence
    where evidence.source = from_source and list_contains(given, object)
),

-- L′: log softmax over the predicted rooms of L − λ b.
shares as (
    select
        object,
        room,
        adjusted - highest
            - ln(sum(exp(adjusted - highest)) over (partition by object)) as log_p
    from (select *, max(adjusted) over (partition by object) as highest from known)
),

-- w = (log n − H′)^γ; 0^0 is 1, as in the naive product.
weighted as (
    select
        room,
        log_p,
        power(
            greatest(
                ln(count(*) over (partition by object)) + sum(
                    case when exp(log_p) > 0 then exp(log_p) * log_p else 0::double end
                ) over (partition by object),
                0::double
            ),
            evidence_power
        ) as weight
    from shares
),

pooled as (
    select room, sum(case when weight > 0 then weight * log_p else 0::double end) as evidence_nats
    from weighted
    group by room
)

-- Evidence that rules out every room leaves them all alike.
select room, evidence_nats, likelihood / sum(likelihood) over () as p_room
from (
    select
        *,
        case
            when isinf(max(evidence_nats) over ()) then 1::double
            else exp(evidence_nats - max(evidence_nats) over ())
        end as likelihood
    from pooled
)
order by p_room desc, room
