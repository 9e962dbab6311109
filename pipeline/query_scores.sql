-- One row per source, combination: the score of its query sentence for each predicted room.
with scored as (
    select
        queries.source,
        queries.key,
        queries.objects,
        queries.room_position,
        case (select reduction from parameters)
            when 'mean' then sentence_scores.log_prob / sentence_scores.token_count
            else sentence_scores.log_prob
        end as score
    from queries
    join sentence_scores on sentence_scores.sentence = queries.sentence
)

select
    source,
    key,
    any_value(objects) as objects,
    list(score::float order by room_position) as scores
from scored
group by source, key
order by source, key
