-- answers(given, from_source, k, among):
-- rule query: S of the sentence that names the picked objects, and p(room), best first; no row
-- where the tables lack the sentence. A room of unknown objects alone has one row without a room.
create macro answers(given, from_source := null, k := null, among := null) as table
select
    room,
    score,
    exp(log_softmax(score, list(score) over ())) as p_room,
    unknown_objects(given) as unknown_objects
from query_scores_long
where query_scores_long.source = coalesce(from_source, (select decision.source from decision))
    and query_scores_long.objects = (
        select list(object order by rank)
        from picked(given, k := k, from_source := from_source)
        where object is not null
    )
    and (among is null or list_contains(among, room))
union all
select null, null, null, unknown_objects(given)
where nothing_known(given)
order by score desc, room
