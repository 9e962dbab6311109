-- nothing_known(given):
-- whether there are names, and no object bears any of them.
create macro nothing_known(given) as (
    len(known_objects(given)) = 0 and len(unknown_objects(given)) > 0
)
