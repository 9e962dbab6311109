-- One row per source, object, predicted room: what the object alone says, and the model's taste.
-- log_probability is L = log softmax over the predicted rooms of S(o, r) (of log p for counts);
-- bias_nats is b, the mean of the proxy's L over the label space's objects; counts have none.
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
),

-- Counts without smoothing may rule out every predicted room: then all are alike.
shifted as (
    select
        source,
        object,
        room,
        case
            when isinf(max(score) over of_object) then 0::double
            else score - max(score) over of_object
        end as score
    from scored
    window of_object as (partition by source, object)
)

select
    shifted.source,
    shifted.object,
    shifted.room,
    shifted.score - ln(sum(exp(shifted.score)) over (partition by shifted.source, shifted.object))
        as log_probability,
    case when shifted.source = 'proxy' then room_bias.bias_nats else 0::double end as bias_nats
from shifted
join room_bias using (source, room)
