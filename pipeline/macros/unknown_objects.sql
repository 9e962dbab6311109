-- unknown_objects(given):
-- the names that no object bears.
create macro unknown_objects(given) as (
    select coalesce(list(distinct asked.name order by asked.name), [])
    from (select unnest(given::varchar[]) as name) as asked
    anti join names on names.name = normalised_name(asked.name)
    where normalised_name(asked.name) != ''
)
