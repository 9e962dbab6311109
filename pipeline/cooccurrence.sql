-- One row per source, object, room: how the object's probability spreads over all rooms.
-- proxy: softmax over rooms of the single-object score S (paper equation 2), which is that of the
-- model's sentence, or comes from the imported table `scores`. Of several templates, S is the mean of
-- the log softmax over rooms of each one's score.
-- ground_truth: counts with additive smoothing.
with worded as (
    select
        single_sentences.object,
        single_sentences.room,
        single_sentences.template,
        case (select reduction from parameters)
            when 'mean' then sentence_scores.log_prob / sentence_scores.token_count
            else sentence_scores.log_prob
        end as score
    from single_sentences
    join sentence_scores using (sentence)
),

worded_shifted as (
    select
        *,
        max(score) over (partition by object, template) as highest,
        exp(score - max(score) over (partition by object, template)) as likelihood
    from worded
),

worded_log_probabilities as (
    select
        object,
        room,
        template,
        score,
        score - highest
            - ln(sum(likelihood) over (partition by object, template)) as log_probability
    from worded_shifted
),

single_scores as (
    select object, room, score
    from scores
    union all
    select
        object,
        room,
        case
            when count(*) = 1 then any_value(score)
            else avg(log_probability)
        end as score
    from worded_log_probabilities
    group by object, room
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
