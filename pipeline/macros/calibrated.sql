-- calibrated(given, from_source, prior_weight, k, among):
-- rule calibrated: S − λ b of the sentence that names the picked objects, and p(room), best first;
-- no row where the tables lack the sentence. A room of unknown objects alone has one row without a
-- room.
create macro calibrated(
    given, from_source := null, prior_weight := null, k := null, among := null
) as table
select
    room,
    calibrated_nats,
    exp(log_softmax(calibrated_nats, list(calibrated_nats) over ())) as p_room,
    unknown_objects(given) as unknown_objects
from (
    select
        room,
        score
        - coalesce(prior_weight, (select decision.prior_weight from decision)) * bias_nats
            as calibrated_nats
    from answers(given, from_source := from_source, k := k, among := among)
    join room_bias using (room)
    where room_bias.source = coalesce(from_source, (select decision.source from decision))
)
union all
select null, null, null, unknown_objects(given)
where nothing_known(given)
order by calibrated_nats desc, room
