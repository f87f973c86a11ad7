# The questions of analysis.md, answered with R.
#
#   Rscript docs/analysis.R [STORE [FOLDER]]
#
# prints the answers about a store (jitai.sqlite by default), or writes them into FOLDER as 1.csv,
# 2.csv and so on. Every section stands on the first one alone, to be copied into a script. The
# quickstart has to be in the store and complete; questions about other experiments that it lacks
# stay without an answer.

# The views of the store, and the completed runs of an experiment.
arguments <- commandArgs(trailingOnly = TRUE)
path <- if (length(arguments) > 0) arguments[1] else "jitai.sqlite"
store <- DBI::dbConnect(RSQLite::SQLite(), path, flags = RSQLite::SQLITE_RO)
view <- function(name) DBI::dbGetQuery(store, paste("SELECT * FROM", name))
runs <- view("run_summary")
# Numbers and texts stand in one column, to which R gives one type.
parameters <- DBI::dbGetQuery(
  store, "SELECT job_key, name, CAST(value AS TEXT) AS value FROM parameter"
)
metrics <- view("metric")
curves <- view("learning_curve")
episodes <- view("evaluation_episode")
choices <- view("action_choice")
arm_summary <- view("arm_summary")
decisions <- view("decision")
DBI::dbDisconnect(store)

completed <- subset(runs, status == "completed")
with_results <- subset(arm_summary, !is.na(mean_return))
quickstart <- subset(with_results, experiment == "quickstart")
arms <- quickstart[c("job_key", "agent", "scenario", "label", "seed")]
# Every environment parameter of a job, as one text.
of_environment <- subset(parameters[order(parameters$name), ], startsWith(name, "environment."))
environment <- aggregate(
  list(environment = paste(of_environment$name, of_environment$value, sep = "=")),
  of_environment["job_key"], paste, collapse = " "
)
answers <- list()

# 1. What did each arm reach, over its seeds?
of_arm <- mean_return ~ agent + scenario + label
summary <- function(v) c(seeds = length(v), mean = mean(v), sd = sd(v), lowest = min(v), highest = max(v))
# aggregate() keeps the five numbers as one column that is a matrix; this makes them five.
flat <- function(table) do.call(data.frame, c(unclass(table), check.names = FALSE))
answers[["1"]] <- setNames(
  flat(aggregate(of_arm, quickstart, summary)),
  c("agent", "scenario", "label", "seeds", "mean", "sd", "lowest", "highest")
)

# 2. How much do probabilities gain over the most likely context (P-H-D minus L-H-D)?
means <- aggregate(mean_return ~ agent + label + scenario, quickstart, mean)
pairs <- merge(
  subset(means, scenario == "P-H-D"), subset(means, scenario == "L-H-D"), by = c("agent", "label")
)
pairs$gain <- pairs$mean_return.x - pairs$mean_return.y
answers[["2"]] <- pairs[c("agent", "label", "gain")]

# 3. Does every seed show the gain?
columns <- c("agent", "label", "seed", "mean_return")
pairs <- merge(
  subset(quickstart, scenario == "P-H-D", columns), subset(quickstart, scenario == "L-H-D", columns),
  by = c("agent", "label", "seed"), suffixes = c("_p", "_l")
)
pairs$gain <- pairs$mean_return_p - pairs$mean_return_l
answers[["3"]] <- pairs[c("agent", "label", "seed", "gain")]

# 4. Is the gain more than chance?
# The test also has the p value and an interval: print(test).
paired <- function(arm) {
  test <- t.test(arm$mean_return_p, arm$mean_return_l, paired = TRUE)
  data.frame(
    agent = arm$agent[1], label = arm$label[1], gain = unname(test$estimate),
    standard_error = test$stderr, t = unname(test$statistic), degrees_of_freedom = unname(test$parameter)
  )
}
by_arm <- split(pairs, pairs[c("agent", "label")], drop = TRUE)
answers[["4"]] <- do.call(rbind, lapply(by_arm, paired))

# 5. What share of the best arm's return does each arm reach?
means <- aggregate(
  cbind(mean = mean_return) ~ environment + agent + scenario + label,
  merge(quickstart, environment, by = "job_key"), mean
)
means$share_of_best <- means$mean / ave(means$mean, means$environment, FUN = max)
answers[["5"]] <- means[order(means$label, -means$mean), names(means) != "environment"]

# 6. Which run was best, and which worst?
columns <- c("agent", "scenario", "label", "seed", "mean_return", "disengagement_rate", "job_key")
answers[["6"]] <- quickstart[order(-quickstart$mean_return), columns]

# 7. What return do the least fortunate people get?
tested <- merge(arms, episodes, by = "job_key")
quartiles <- function(v) quantile(v, c(0.25, 0.5), type = 1, names = FALSE)
flat <- function(table) do.call(data.frame, c(unclass(table), check.names = FALSE))
answers[["7"]] <- setNames(
  flat(aggregate(total_reward ~ agent + scenario + label, tested, quartiles)),
  c("agent", "scenario", "label", "lower_quartile", "median")
)

# 8. How often do episodes end in disengagement, and what does that cost in messages?
tested <- transform(quickstart, messages_per_episode = message_rate * mean_length)
answers[["8"]] <- aggregate(
  cbind(disengagement_rate, mean_length, messages_per_episode) ~ agent + scenario + label, tested, mean
)

# 9. When do people disengage?
tested <- merge(arms, episodes, by = "job_key")
tested$step <- tested$length
answers[["9"]] <- aggregate(
  cbind(disengagements = disengaged) ~ agent + scenario + label + step, subset(tested, disengaged == 1), sum
)

# 10. Which actions are chosen, by how sure the inference is?
chosen <- merge(arms, choices, by = "job_key")
steps <- aggregate(cbind(steps = count) ~ agent + scenario + label + p_low + p_high + action, chosen, sum)
steps$share <- steps$steps / ave(steps$steps, steps[c("agent", "scenario", "label", "p_low")], FUN = sum)
answers[["10"]] <- steps

# 11. How many messages are sent, and how many tailored messages fit the context?
chosen <- merge(arms, choices, by = "job_key")
of_arm <- function(chosen) {
  steps <- function(which) sum(chosen$count[which])
  data.frame(
    chosen[1, c("agent", "scenario", "label")],
    message_rate = steps(chosen$action > 0) / sum(chosen$count),
    share_that_fits = steps(chosen$action == chosen$context + 2) / steps(chosen$action >= 2)
  )
}
by_arm <- split(chosen, chosen[c("agent", "scenario", "label")], drop = TRUE)
answers[["11"]] <- do.call(rbind, lapply(by_arm, of_arm))

# 12. What does the learning curve look like, smoothed?
learning <- merge(arms, subset(curves, metric == "mean_return"), by = "job_key")
learning <- learning[order(learning$job_key, learning$agent, learning$episode), ]
# A mean over ten points; the first nine of each curve are over the points that there are.
moving_mean <- function(v) {
  sums <- cumsum(v)
  (sums - c(rep(0, min(10, length(v))), head(sums, -10))) / pmin(seq_along(v), 10)
}
learning$moving_mean_return <- ave(learning$value, learning[c("job_key", "agent")], FUN = moving_mean)
answers[["12"]] <- learning[c("agent", "scenario", "label", "seed", "episode", "moving_mean_return")]

# 13. After how many episodes is an agent within 5 % of its final return?
learning <- merge(arms, subset(curves, metric == "mean_return"), by = "job_key")
learning <- learning[order(learning$job_key, learning$agent, learning$episode), ]
moving_mean <- function(v) {
  sums <- cumsum(v)
  (sums - c(rep(0, min(10, length(v))), head(sums, -10))) / pmin(seq_along(v), 10)
}
run <- learning[c("job_key", "agent")]
learning$smoothed <- ave(learning$value, run, FUN = moving_mean)
learning$ending <- ave(learning$smoothed, run, FUN = function(v) tail(v, 1))
answers[["13"]] <- aggregate(
  cbind(episodes = episode) ~ agent + scenario + label + seed,
  subset(learning, smoothed >= 0.95 * ending), min
)

# 14. How does the gain depend on the disengagement dynamics?
value_of <- function(job_keys, name) {
  those <- parameters[parameters$name == name, ]
  those$value[match(job_keys, those$job_key)]
}
dynamics <- subset(with_results, experiment == "disengagement")
dynamics$delta_d <- as.numeric(value_of(dynamics$job_key, "environment.delta_d"))
dynamics$epsilon_d <- as.numeric(value_of(dynamics$job_key, "environment.epsilon_d"))
if (nrow(dynamics) > 0) {
  means <- aggregate(mean_return ~ agent + label + delta_d + epsilon_d + scenario, dynamics, mean)
  pairs <- merge(
    subset(means, scenario == "P-H-D"), subset(means, scenario == "L-H-D"),
    by = c("agent", "label", "delta_d", "epsilon_d")
  )
  pairs$gain <- pairs$mean_return.x - pairs$mean_return.y
  answers[["14"]] <- pairs[c("agent", "label", "delta_d", "epsilon_d", "gain")]
}

# 15. What were the parameters of a job?
job <- subset(quickstart, agent == "dqn" & scenario == "P-H-D" & seed == 1)
answers[["15"]] <- subset(parameters, job_key == job$job_key[order(job$label)][1], c(name, value))

# 16. Which parameters does an experiment vary, and over which values?
held <- merge(subset(runs, experiment == "disengagement"), parameters, by = "job_key")
of_parameter <- function(held) {
  values <- unique(held$value)
  numbers <- suppressWarnings(as.numeric(values))
  if (!anyNA(numbers)) values <- numbers
  data.frame(held[1, c("agent", "name")], different = length(values), lowest = min(values), highest = max(values))
}
if (nrow(held) > 0) {
  varied <- do.call(rbind, lapply(split(held, held[c("agent", "name")], drop = TRUE), of_parameter))
  answers[["16"]] <- subset(varied, different > 1)
}

# 17. Which runs failed?
failed <- subset(runs, status == "failed")
answers[["17"]] <- failed[order(failed$started_at), c(
  "experiment", "agent", "scenario", "sigma", "seed", "attempt", "failure_kind", "failure_message", "job_key"
)]

# 18. How many seeds does each arm have, and how many are missing?
held <- transform(arm_summary, seeds = 1, completed = !is.na(mean_return), without_results = is.na(mean_return))
seeds <- aggregate(
  cbind(seeds, completed, without_results) ~ experiment + agent + scenario + label, held, sum
)
answers[["18"]] <- seeds[order(-seeds$without_results), ]

# 19. How long does a job of each algorithm take?
jobs <- merge(
  unique(completed[c("job_key", "wall_seconds")]), subset(parameters, name == "agent.algorithm"), by = "job_key"
)
of_algorithm <- function(jobs) {
  data.frame(
    algorithm = jobs$value[1], runs = nrow(jobs), mean_seconds = mean(jobs$wall_seconds),
    longest = max(jobs$wall_seconds), hours_in_all = sum(jobs$wall_seconds) / 3600
  )
}
answers[["19"]] <- do.call(rbind, lapply(split(jobs, jobs$value), of_algorithm))

# 20. Which experiments share jobs?
held <- unique(runs[c("experiment", "job_key")])
pairs <- merge(held, setNames(held, c("shares_with", "job_key")), by = "job_key")
pairs <- subset(pairs, shares_with > experiment)
if (nrow(pairs) > 0) {
  answers[["20"]] <- aggregate(cbind(jobs = job_key) ~ experiment + shares_with, pairs, length)
}

# 21. Which version of jitai made which results?
version <- completed[c("experiment", "code_version")]
answers[["21"]] <- data.frame(
  aggregate(list(runs = completed$job_key), version, length),
  first = aggregate(completed$started_at, version, min)$x,
  last = aggregate(completed$ended_at, version, max)$x
)

# 22. Which jobs needed more than one attempt?
attempts <- unique(runs[c("job_key", "agent", "scenario", "sigma", "seed", "attempt", "status")])
attempts <- attempts[order(attempts$attempt), ]
job <- attempts[c("job_key", "agent", "scenario", "sigma", "seed")]
tried <- data.frame(
  aggregate(list(attempts = attempts$attempt), job, length),
  what_became_of_them = aggregate(attempts$status, job, paste, collapse = ", ")$x
)
answers[["22"]] <- subset(tried, attempts > 1, -job_key)

# 23. Does the return agree with the episodes it was computed from?
again <- tapply(episodes$total_reward, episodes$job_key, mean)
answers[["23"]] <- data.frame(
  largest_difference = max(abs(completed$mean_return - again[completed$job_key]))
)

# 24. What share of the optimum does each agent reach?
both <- merge(subset(with_results, experiment %in% c("quickstart", "reference")), environment, by = "job_key")
means <- aggregate(mean_return ~ environment + agent + scenario + label, both, mean)
best <- subset(means, agent == "optimal", c(environment, scenario, mean_return))
shares <- merge(means, best, by = c("environment", "scenario"), suffixes = c("", "_best"))
shares$share <- shares$mean_return / shares$mean_return_best
answers[["24"]] <- shares[c("agent", "scenario", "label", "share")]

# The trial of decisions.md: what was recorded of every step, and the arm that it belongs to.
trial <- subset(arm_summary, experiment == "trial", c(job_key, agent, scenario, label, seed))
trial <- merge(trial, subset(decisions, phase == "test"), by = "job_key")

# 25. How many messages are sent at each level of habituation and disengagement risk?
level <- function(v) pmin(3, floor(4 * v)) / 4
if (nrow(trial) > 0) {
  levels <- transform(
    subset(trial, can_send == 1), habituation_from = level(habituation), disengagement_from = level(disengagement),
    steps = 1, sent = action > 0
  )
  of_level <- cbind(steps, sent) ~ agent + scenario + label + habituation_from + disengagement_from
  answers[["25"]] <- transform(aggregate(of_level, levels, sum), message_rate = sent / steps)
}

# 26. What does a message change immediately?
randomised <- subset(trial, agent == "random" & can_send == 1)
if (nrow(randomised) > 0) {
  randomised$weight <- 1 / randomised$action_probability
  randomised$weighted <- randomised$weight * randomised$reward
  sums <- aggregate(cbind(weight, weighted) ~ label + context + action, randomised, sum)
  sums$reward <- sums$weighted / sums$weight
  effects <- merge(subset(sums, action > 0), subset(sums, action == 0), by = c("label", "context"))
  effects <- transform(effects, action = action.x, effect = reward.x - reward.y)
  answers[["26"]] <- effects[c("label", "context", "action", "effect")]
}

# 27. What would another policy have earned in the first three steps?
first <- subset(trial[order(trial$job_key, trial$episode, trial$step), ], step < 3)
randomised <- subset(first, agent == "random")
if (nrow(randomised) > 0) {
  follows <- randomised$action == randomised$likely_context + 2 | randomised$can_send == 0
  factor <- follows / randomised$action_probability
  randomised$value <- ave(factor, randomised[c("job_key", "episode")], FUN = cumprod) * randomised$reward
  estimated <- aggregate(value ~ label + job_key + episode, randomised, sum)
  actual <- aggregate(reward ~ label + job_key + episode, subset(first, agent == "tailored"), sum)
  of_label <- function(label) {
    values <- estimated$value[estimated$label == label]
    data.frame(
      label = label, estimated = mean(values), standard_error = sd(values) / sqrt(length(values)),
      actual = mean(actual$reward[actual$label == label])
    )
  }
  answers[["27"]] <- do.call(rbind, lapply(unique(estimated$label), of_label))
}

# Printed, or written as files.
for (question in names(answers)) {
  if (length(arguments) > 1) {
    dir.create(arguments[2], showWarnings = FALSE, recursive = TRUE)
    file <- file.path(arguments[2], paste0(question, ".csv"))
    write.csv(answers[[question]], file, row.names = FALSE, na = "")
  } else {
    cat("\n", question, ".\n", sep = "")
    print(answers[[question]], row.names = FALSE)
  }
}
