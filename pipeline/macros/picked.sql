-- picked(given, k := 3, from_source := 'proxy'):
-- the k most informative of the objects, in the order in which a query sentence names them.
create macro picked(given, k := 3, from_source := 'proxy') as table
select rank, object, entropy_nats
from entropy
where entropy.source = from_source and list_contains(given, object)
order by rank
limit k
