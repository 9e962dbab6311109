-- One row per source, object, room: how the object's probability spreads over all rooms.
-- proxy: softmax over rooms of the single-object sentence's score S (paper equation 2), which is the
-- model's, or comes from the imported table `scores`.
-- ground_truth: counts with additive smoothing.
with single_scores as (
    select object, room, score
    from scores
    union all
    select
        single_sentences.object,
        single_sentences.room,
        case (select reduction from parameters)
            when 'mean' then sentence_scores.log_prob / sentence_scores.token_count
            else sentence_scores.log_prob
        end as score
    from single_sentences
    join sentence_scores using (sentence)
),

proxy_shifted as (
    select
        object,
        room,
        score,
        exp(score - max(score) over (partition by object)) as likelihood
    from single_scores
),

proxy as (
    select
        'proxy' as source,
        object,
        room,
        null::double as count,
        score,
        likelihood / sum(likelihood) over (partition by object) as p_room_given_object
    from proxy_shifted
),

smoothed as (
    select
        object,
        room,
        count,
        count + (select smoothing from parameters) as mass
    from counts
),

-- An object that was never seen, without smoothing, says nothing: all rooms are alike.
ground_truth as (
    select
        'ground_truth' as source,
        object,
        room,
        count,
        null::double as score,
        case
            when sum(mass) over (partition by object) > 0
                then mass / sum(mass) over (partition by object)
            else 1::double / count(*) over (partition by object)
        end as p_room_given_object
    from smoothed
)

select * from ground_truth
union all
select * from proxy
order by source, object, room
