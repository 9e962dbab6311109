-- read_names(given):
-- the object that each name stands for, and how; for a name that no object bears, the nearest one.
create macro read_names(given) as table
select
    asked.name as given,
    names.object,
    names.how,
    case
        when names.object is null then (
            select arg_max(known.name, jaro_winkler_similarity(known.name, asked.name))
            from names as known
            where jaro_winkler_similarity(known.name, asked.name) > 0.85
        )
    end as nearest
from (
    select unnest(given::varchar[]) as name, generate_subscripts(given::varchar[], 1) as place
) as asked
left join names on names.name = normalised_name(asked.name)
order by asked.place
