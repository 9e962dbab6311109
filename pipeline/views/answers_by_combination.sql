-- One row per source, rule, combination: the answer, the second room, and how far they are apart.
-- The rules are query, and calibrated with the published λ; margin_nats is the difference of what
-- the rule compares, log(p_room / second_p_room). In a label space of one room there is no second.
with compared as (
    select
        source,
        'query' as rule,
        objects,
        room,
        score as compared_nats
    from query_scores_long
    union all
    select
        query_scores_long.source,
        'calibrated' as rule,
        objects,
        room,
        score - decision.prior_weight * bias_nats as compared_nats
    from query_scores_long
    join room_bias using (source, room)
    cross join decision
),

ranked as (
    select
        source,
        rule,
        objects,
        list(room order by compared_nats desc, room) as rooms,
        list(compared_nats order by compared_nats desc, room) as nats
    from compared
    group by source, rule, objects
)

select
    source,
    rule,
    objects,
    rooms[1] as room,
    exp(log_softmax(nats[1], nats)) as p_room,
    rooms[2] as second_room,
    exp(log_softmax(nats[2], nats)) as second_p_room,
    nats[1] - nats[2] as margin_nats
from ranked
