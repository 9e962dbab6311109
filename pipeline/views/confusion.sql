-- One row per saved evaluation, source, rule, true room, answer: how many rooms; null is no answer.
select
    evaluation,
    source,
    rule,
    room,
    predicted,
    count(*) as rooms
from evaluations
group by all
