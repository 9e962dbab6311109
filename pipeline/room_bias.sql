-- One row per source, predicted room: the model's taste in room names, whatever the object.
-- b = mean over objects of log softmax of the single-object score over the predicted rooms.
-- For ground_truth it is the same taste: the query sentences are scored by the same model.
with predicted_scores as (
    select s.object, s.room, s.score, max(s.score) over (partition by s.object) as highest
    from cooccurrence as s
    join rooms on rooms.label = s.room
    where s.source = 'proxy' and rooms.predicted
),

log_probabilities as (
    select
        object,
        room,
        score - highest
            - ln(sum(exp(score - highest)) over (partition by object)) as log_probability
    from predicted_scores
),

bias as (
    select room, avg(log_probability) as bias_nats
    from log_probabilities
    group by room
)

select sources.source, bias.room, bias.bias_nats
from bias
cross join (select distinct source from cooccurrence) as sources
order by sources.source, bias.room
