-- Entropy lies between 0 and the logarithm of the number of rooms.
select source, object, entropy_nats
from entropy
where not (entropy_nats between 0 and ln((select count(*) from rooms)) + 1e-9)
