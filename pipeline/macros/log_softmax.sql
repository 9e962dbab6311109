-- log_softmax(score, scores):
-- the logarithm of a score's share among scores, in nats; where all are −inf, all are alike.
create macro log_softmax(score, scores) as
case
    when isinf(list_max(scores)) then -ln(len(scores))
    else
        score - list_max(scores)
        - ln(list_sum(list_transform(scores, lambda other: exp(other - list_max(scores)))))
end
