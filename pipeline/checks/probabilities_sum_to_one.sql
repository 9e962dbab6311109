-- p(room | object) sums to 1 over the rooms, for every source and object.
select source, object, sum(p_room_given_object) as total
from cooccurrence
group by source, object
having not (abs(total - 1) < 1e-9)
