-- One row per object and room: the score S of the single-object sentence, in nats.
select
    single_sentences.object,
    single_sentences.room,
    case (select reduction from parameters)
        when 'mean' then sentence_scores.log_prob / sentence_scores.token_count
        else sentence_scores.log_prob
    end as score
from single_sentences
join sentence_scores using (sentence)
