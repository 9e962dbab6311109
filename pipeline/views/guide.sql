-- One row per view and macro: how it is called, and what it holds.
select view_name as name, comment as holds
from duckdb_views()
where not internal and database_name = current_database()
union all
select
    function_name || '(' || array_to_string(parameters, ', ') || ')' as name,
    comment as holds
from duckdb_functions()
where not internal
    and function_type in ('macro', 'table_macro')
    and database_name = current_database()
order by name
