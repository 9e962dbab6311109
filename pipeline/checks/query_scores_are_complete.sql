-- Every combination that was asked for is there once, with one finite score per predicted room.
with cells as (
    unpivot query_scores
    on columns(* exclude (source, key, objects))
    into name room value score
),

found as (
    select
        source,
        key,
        count(*) as scores,
        count(distinct room) as rooms,
        bool_and(isfinite(score)) as finite
    from cells
    group by source, key
)

select coalesce(queries.source, found.source) as source, coalesce(queries.key, found.key) as key
from queries
full join found
    on found.source = queries.source and found.key = queries.key
where queries.key is null
    or found.key is null
    or not found.finite
    or found.scores <> found.rooms
    or found.rooms <> (select count(*) from rooms where predicted)
