-- One row per source, predicted room, object: what the room is recognised by, best first.
-- lift_nats = L(o, r) − b(r), pointwise mutual information: how much likelier the object makes the
-- room than the label space's objects do on average.
select
    source,
    room,
    row_number() over (
        partition by source, room
        order by round(log_probability - bias_nats, 10) desc, object
    )::integer as rank,
    object,
    exp(log_probability) as p_room_given_object,
    log_probability - bias_nats as lift_nats
from (
    select
        source,
        object,
        room,
        log_probability,
        avg(log_probability) over (partition by source, room) as bias_nats
    from evidence
)
