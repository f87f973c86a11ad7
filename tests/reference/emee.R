# Writes emee.json: log relative risks, estimated by the authors' R package MRTAnalysis.
#
#     R -e 'install.packages("MRTAnalysis")'    # 0.3.0 or newer, with rootSolve
#     Rscript tests/reference/emee.R            # writes emee.json beside this file, or to a file that it is given
#
# `make test-analysis` runs it again where the package is at hand, and compares the numbers.
#
# The first data set is the package's own example, data_binary, drawn here from its description with the same seed; the
# script compares both. The second has counts, probabilities that differ between people and drift, and few people.
library(MRTAnalysis)

binary <- function(people, times) {
    draw <- function(p) rbinom(people, 1, p)
    rows <- list()
    for (t in 1:times) {
        available <- draw(0.8)
        p <- c(0.7, 0.3, 0.5)[t %% 3 + 1]
        action <- draw(p) * available
        share <- t / times
        late <- as.numeric(share > 0.5)
        mean <- exp(-1.5 + 0.5 * share + 0.3 * late + action * (0.1 + 0.3 * share))
        rows[[t]] <- data.frame(
            userid = 1:people, time = t, time_var1 = share, time_var2 = late, Y = draw(mean), A = action,
            avail = available, rand_prob = p
        )
    }
    rows <- do.call(rbind, rows)
    rows[order(rows$userid, rows$time), ]
}

counts <- function(people, times) {
    level <- rnorm(people, 0, 0.3)
    rows <- list()
    for (t in 1:times) {
        mood <- round(runif(people), 3)
        available <- rbinom(people, 1, 0.9)
        p <- round(pmin(0.85, pmax(0.15, 0.3 + 0.02 * t + 0.1 * rnorm(people))), 3)
        action <- rbinom(people, 1, p) * available
        mean <- exp(0.8 + level - 0.4 * mood + action * (0.3 - 0.2 * mood))
        rows[[t]] <- data.frame(
            userid = 1:people, time = t, time_var1 = mood, time_var2 = mood^2, Y = rpois(people, mean), A = action,
            avail = available, rand_prob = p
        )
    }
    rows <- do.call(rbind, rows)
    rows[order(rows$userid, rows$time), ]
}

number <- function(x) format(x, digits = 17, scientific = TRUE, trim = TRUE)
list_of <- function(x) paste0("[", paste(x, collapse = ", "), "]")
texts <- function(x) list_of(if (length(x)) paste0('"', x, '"') else x)

# The exported emee() takes outcomes of 0 and 1 alone; what it calls takes counts, too.
fit <- function(data, control, moderators, numerator) {
    matrix_of <- function(names) model.matrix(as.formula(paste("~", paste(c("1", names), collapse = "+"))), data = data)
    found <- MRTAnalysis:::compute_emee(
        id = data$userid, A = data$A, Y = data$Y, p_t = data$rand_prob, avail = data$avail,
        p_t_tilde = rep(numerator, nrow(data)), moderator_matrix = matrix_of(moderators), control_matrix = matrix_of(control)
    )
    stopifnot(max(abs(found$f.root)) < 1e-7)
    names <- function(x) c(time_var1 = "share", time_var2 = "late")[x]
    paste0(
        '{"control": ', texts(names(control)), ', "moderators": ', texts(names(moderators)), ', "numerator": ', numerator,
        ', "estimate": ', list_of(number(found$beta_hat)), ', "standard_error": ', list_of(number(found$beta_se_adjusted)),
        ', "uncorrected_error": ', list_of(number(found$beta_se)),
        ', "low": ', list_of(number(found$conf_int_adjusted[, 1])), ', "high": ', list_of(number(found$conf_int_adjusted[, 2])), "}"
    )
}

case <- function(name, data, models) {
    rows <- with(data, paste0(
        "[", userid, ", ", time - 1, ", ", avail, ", ", A, ", ", rand_prob, ", ", number(time_var1), ", ", number(time_var2), ", ", Y, "]"
    ))
    paste0(
        '{"name": "', name, '", "models": [\n', paste(sapply(models, function(m) do.call(fit, c(list(data), m))), collapse = ",\n"),
        '\n], "decisions": [\n', paste(rows, collapse = ",\n"), "\n]}"
    )
}

set.seed(123)
own <- binary(100, 30)
for (column in names(own)) stopifnot(all.equal(own[[column]], data_binary[[column]], tolerance = 0))
both <- c("time_var1", "time_var2")
first <- case("data_binary", own, list(
    list(both, character(0), 0.5), list(both, "time_var1", 0.5), list("time_var1", c("time_var1", "time_var2"), 0.4)
))
# The exported function gives the same.
exported <- emee(own, "userid", "Y", "A", "rand_prob", ~time_var1, ~ time_var1 + time_var2, "avail", verbose = FALSE)
stopifnot(grepl(number(exported$fit$beta_hat[1]), first, fixed = TRUE))
set.seed(2021)
second <- case("counts", counts(14, 20), list(
    list("time_var1", character(0), 0.5), list("time_var1", "time_var1", 0.3), list(character(0), "time_var2", 0.5)
))
version <- function(package) paste0('"', package, '": "', packageVersion(package), '"')
written <- paste0(
    '{"versions": {"R": "', R.version.string, '", ', version("MRTAnalysis"), ", ", version("rootSolve"), "},\n",
    '"columns": ["person", "step", "available", "action", "probability", "share", "late", "outcome"],\n',
    '"cases": [', first, ",\n", second, "]}\n"
)
here <- dirname(sub("--file=", "", grep("--file=", commandArgs(), value = TRUE)))
given <- commandArgs(trailingOnly = TRUE)
cat(written, file = if (length(given)) given[1] else file.path(here, "emee.json"))
