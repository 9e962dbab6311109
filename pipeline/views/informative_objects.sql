-- One row per source, object: how informative it is, and the predicted room that it speaks for.
select
    entropy.source,
    entropy.rank,
    entropy.object,
    entropy.entropy_nats,
    ln((select count(*) from rooms)) - entropy.entropy_nats as information_nats,
    arg_max(cooccurrence.room, cooccurrence.p_room_given_object) as room,
    max(cooccurrence.p_room_given_object) as p_room_given_object
from entropy
join cooccurrence using (source, object)
join rooms on rooms.label = cooccurrence.room
where rooms.predicted
group by all
