-- decided(given, by_rule, from_source, prior_weight, evidence_power, k, among, backoff):
-- what the published rule, or another by name, compares, and p(room), best first. Where the tables
-- lack the sentence of rule query or calibrated, rule pooled decides, unless backoff := false; a
-- room of unknown objects alone has one row without an answer.
create macro decided(
    given,
    by_rule := null,
    from_source := null,
    prior_weight := null,
    evidence_power := null,
    k := null,
    among := null,
    backoff := true
) as table
with compared as (
    select 'query' as rule, room, score as compared_nats, p_room
    from answers(given, from_source := from_source, k := k, among := among)
    where room is not null
    union all
    select 'calibrated' as rule, room, calibrated_nats as compared_nats, p_room
    from calibrated(
        given, from_source := from_source, prior_weight := prior_weight, k := k, among := among
    )
    where room is not null
    union all
    select 'pooled' as rule, room, evidence_nats as compared_nats, p_room
    from p_room_given(
        given,
        from_source := from_source,
        prior_weight := prior_weight,
        evidence_power := evidence_power,
        among := among
    )
    where room is not null
),

wanted as (
    select * from compared
    where compared.rule = coalesce(by_rule, (select decision.rule from decision))
),

found as (
    select * from wanted
    union all
    select * from compared
    where compared.rule = 'pooled' and backoff and not exists (from wanted)
)

select room, compared_nats, p_room, rule, unknown_objects(given) as unknown_objects
from found
union all
select null, null, null, null, unknown_objects(given)
where nothing_known(given)
order by compared_nats desc, room
