-- One row per source, combination: the score of its query sentence, in a column per predicted room.
with scored as (
    select
        query_sentences.source,
        query_sentences.key,
        query_sentences.room,
        case (select reduction from parameters)
            when 'mean' then sentence_scores.log_prob / sentence_scores.token_count
            else sentence_scores.log_prob
        end::float as score
    from query_sentences
    join sentence_scores using (sentence)
),

per_combination as (
    pivot scored
    on room in (select label from rooms where predicted order by label)
    using any_value(score)
    group by source, key
)

select queries.objects, per_combination.*
from queries
join per_combination using (source, key)
order by source, key
