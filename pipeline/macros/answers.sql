-- answers(given, from_source := 'proxy'):
-- the query sentence's score and p(room) of a combination that the tables hold, best first.
create macro answers(given, from_source := 'proxy') as table
select room, score, p_room
from query_scores_long
where query_scores_long.source = from_source
    and list_sort(query_scores_long.objects) = list_sort(given)
order by score desc, room
