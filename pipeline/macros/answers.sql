-- answers(given, from_source, k, among):
-- rule query: S of the sentence that names the picked objects, and p(room), best first.
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
    )
    and (among is null or list_contains(among, room))
order by score desc, room
