-- Every source has exactly one row for every object and room.
select sources.source, objects.label as object, rooms.label as room, count(c.source) as found
from (select distinct source from cooccurrence) as sources
cross join objects
cross join rooms
left join cooccurrence as c
    on c.source = sources.source and c.object = objects.label and c.room = rooms.label
group by all
having found <> 1
