-- One row per source, combination, predicted room: the score, and the softmax over the rooms.
-- Written with windows, which are several times as fast as log_softmax on millions of rows.
with long as (
    select source, key, objects, room, score::double as score
    from (
        unpivot query_scores
        on columns(* exclude (source, key, objects))
        into name room value score
    )
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
