-- One row per two versions, source, kind, objects: the room that they spoke for, before and after.
-- kind is `object` (p(room | object), with the entropy of it) or `combination` (rule query); null
-- where one of the two versions does not hold it. before and after are any two versions, also the
-- older one as after.
with pairs as (
    select before.version as before, after.version as after
    from versions as before
    join versions as after on before.version <> after.version
),

spoken as (
    select
        version,
        source,
        'combination' as kind,
        list_sort(objects) as objects,
        list(room order by score desc, room)[1] as room,
        list(score order by score desc, room) as scores
    from version_scores
    group by version, source, objects
),

answered as (
    select
        version,
        source,
        kind,
        objects,
        room,
        exp(log_softmax(scores[1], scores)) as p_room,
        null::double as entropy_nats
    from spoken
    union all
    select
        version,
        source,
        'object' as kind,
        [object] as objects,
        list(room order by p_room_given_object desc, room)[1] as room,
        max(p_room_given_object) as p_room,
        any_value(entropy_nats) as entropy_nats
    from version_cooccurrence
    join version_entropy using (version, source, object)
    group by version, source, object
),

earlier as (
    select pairs.before, pairs.after, answered.*
    from pairs join answered on answered.version = pairs.before
),

later as (
    select pairs.before, pairs.after, answered.*
    from pairs join answered on answered.version = pairs.after
)

select
    before,
    after,
    source,
    kind,
    objects,
    earlier.room as room_before,
    later.room as room_after,
    earlier.p_room as p_before,
    later.p_room as p_after,
    earlier.entropy_nats as entropy_before,
    later.entropy_nats as entropy_after
from earlier
full join later using (before, after, source, kind, objects)
