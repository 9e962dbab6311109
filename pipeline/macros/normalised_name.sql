-- normalised_name(given):
-- a name as table names has it: lower case, single spaces, an underscore as a space.
create macro normalised_name(given) as
trim(regexp_replace(lower(replace(given, '_', ' ')), '\s+', ' ', 'g'))
