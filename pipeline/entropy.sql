-- One row per source, object: how little its presence says about the room (paper equation 3).
-- Rank 1 is the most informative object; equal entropies are ranked by label.
with entropies as (
    select
        source,
        object,
        -sum(
            case when p_room_given_object > 0
                then p_room_given_object * ln(p_room_given_object)
                else 0::double
            end
        ) as entropy_nats
    from cooccurrence
    group by source, object
)

select
    source,
    object,
    greatest(entropy_nats, 0::double) as entropy_nats,
    row_number() over (
        partition by source
        order by round(entropy_nats, 10), object
    )::integer as rank
from entropies
order by source, rank
