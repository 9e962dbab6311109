-- Every combination that was asked for is there once, with one finite score per predicted room.
select coalesce(expected.source, found.source) as source, coalesce(expected.key, found.key) as key
from combinations as expected
full join query_scores as found
    on found.source = expected.source and found.key = expected.key
where expected.key is null
    or found.key is null
    or len(found.scores) <> (select count(*) from rooms where predicted)
    or list_bool_or(list_transform(found.scores, lambda score: not isfinite(score)))
union all
select source, key
from query_scores
group by source, key
having count(*) > 1
