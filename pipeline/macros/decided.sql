-- decided(given, by_rule, from_source, prior_weight, evidence_power, k, among):
-- what the published rule, or another by name, compares, and p(room), best first.
create macro decided(
    given,
    by_rule := null,
    from_source := null,
    prior_weight := null,
    evidence_power := null,
    k := null,
    among := null
) as table
select room, compared_nats, p_room
from (
    select 'query' as rule, room, score as compared_nats, p_room
    from answers(given, from_source := from_source, k := k, among := among)
    union all
    select 'calibrated' as rule, room, calibrated_nats as compared_nats, p_room
    from calibrated(
        given, from_source := from_source, prior_weight := prior_weight, k := k, among := among
    )
    union all
    select 'pooled' as rule, room, evidence_nats as compared_nats, p_room
    from p_room_given(
        given,
        from_source := from_source,
        prior_weight := prior_weight,
        evidence_power := evidence_power,
        among := among
    )
) as compared
where compared.rule = coalesce(by_rule, (select decision.rule from decision))
order by compared_nats desc, room
