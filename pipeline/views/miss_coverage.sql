-- One row per combination asked for in vain: whether the published version answers it now.
-- Of those that builds have taken in, it is not known how often and when they were asked for.
select
    noted_misses.source,
    noted_misses.objects,
    noted_misses.times_asked,
    noted_misses.last_asked,
    noted_misses.taken_in,
    held.source is not null as answered
from noted_misses
left join (
    select distinct source, list_sort(objects) as objects
    from query_scores
) as held
    on held.source = noted_misses.source
    and held.objects = list_sort(noted_misses.objects)
