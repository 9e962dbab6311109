-- The ranks of a source are 1, 2, … without gap or tie.
select source, rank, count(*) as found
from entropy
group by source, rank
having found <> 1 or rank not between 1 and (select count(*) from objects)
