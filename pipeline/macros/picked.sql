-- picked(given, k, from_source):
-- the k most informative of the objects, in the order in which a query sentence names them; one row
-- without an object where all are unknown.
create macro picked(given, k := null, from_source := null) as table
select rank, object, entropy_nats, unknown_objects(given) as unknown_objects
from (
    select rank, object, entropy_nats
    from entropy
    where entropy.source = coalesce(from_source, (select decision.source from decision))
        and list_contains(known_objects(given), object)
    order by rank
    limit coalesce(k, (select decision.k from decision))
)
union all
select null, null, null, unknown_objects(given)
where nothing_known(given)
order by rank
