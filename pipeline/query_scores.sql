-- One row per source, combination: the score of its query sentence for each predicted room.
with scored as (
    select
        queries.source,
        queries.key,
        queries.room_position,
        case (select reduction from parameters)
            when 'mean' then sentence_scores.log_prob / sentence_scores.token_count
            else sentence_scores.log_prob
        end::float as score
    from queries
    join sentence_scores using (sentence)
),

per_combination as (
    select source, key, list(score order by room_position) as scores
    from scored
    group by source, key
)

select combinations.source, combinations.key, combinations.objects, per_combination.scores
from combinations
join per_combination using (source, key)
order by source, key
