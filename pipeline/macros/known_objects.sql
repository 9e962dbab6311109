-- known_objects(given):
-- the labels of the objects that names stand for.
create macro known_objects(given) as (
    select coalesce(list(distinct names.object), [])
    from (select unnest(given::varchar[]) as name) as asked
    join names on names.name = normalised_name(asked.name)
)
