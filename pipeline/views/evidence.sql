-- One row per source, object, predicted room: what the object alone says, and the model's bias.
-- log_probability is L = log softmax over the predicted rooms of S(o, r) (of log p for counts);
-- bias_nats is b, which λ takes away: 0 for counts, which have none.
with scored as (
    select
        c.source,
        c.object,
        c.room,
        case
            when c.source = 'proxy' then c.score
            when c.p_room_given_object > 0 then ln(c.p_room_given_object)
            else '-inf'::double
        end as score
    from cooccurrence as c
    join rooms on rooms.label = c.room
    where rooms.predicted
)

select
    scored.source,
    scored.object,
    scored.room,
    log_softmax(score, list(score) over (partition by scored.source, scored.object))
        as log_probability,
    case when scored.source = 'proxy' then room_bias.bias_nats else 0::double end as bias_nats
from scored
join room_bias using (source, room)
