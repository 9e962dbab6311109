-- One row per source, combination, predicted room: the score, and the softmax over the rooms.
with long as (
    select
        source,
        key,
        objects,
        unnest((select list(label order by label) from rooms where predicted)) as room,
        unnest(scores)::double as score
    from query_scores
),

shifted as (
    select *, exp(score - max(score) over (partition by source, key)) as likelihood
    from long
)

select
    source,
    objects,
    room,
    score,
    likelihood / sum(likelihood) over (partition by source, key) as p_room
from shifted
