# The effect of the conditions of a study, with a linear mixed model: a random intercept for each
# participant; condition and position as fixed effects. Run it in the folder of the tables:
#   Rscript analysis.R
# nlme is part of every R. The intervals are those of `humanopts study report`.
library(nlme)

people <- read.csv("participants.csv", encoding = "UTF-8", na.strings = "", stringsAsFactors = TRUE)
rows <- read.csv("conditions.csv", encoding = "UTF-8", na.strings = "", stringsAsFactors = TRUE)
cat("Participants by state:\n")
print(table(people$state))

# One row for each participant who began to teach in the condition, zeros included. People who
# failed too many attention checks are left out, and so are simulated participants, if there are others.
rows <- subset(rows, reached == "yes" & state != "excluded")
if (any(rows$simulated == "no")) rows <- subset(rows, simulated == "no")
rows$condition <- factor(rows$condition, levels = unique(as.character(rows$condition)))
rows$position <- factor(rows$position)

for (outcome in c("demonstrations", "options_learned", "teach_seconds")) {
  cat("\n", outcome, "\n", sep = "")
  print(aggregate(rows[[outcome]], list(condition = rows$condition),
                  function(x) c(n = length(x), mean = mean(x), sd = sd(x))))
  terms <- c("condition", "position")
  terms <- terms[vapply(rows[terms], function(x) length(unique(x)) > 1, logical(1))]
  if (!("condition" %in% terms) || sd(rows[[outcome]]) == 0) next
  # If every participant has one row, there is nothing to tell people and noise apart.
  repeated <- any(duplicated(rows$participant))
  fixed <- reformulate(terms, outcome)
  result <- try(if (repeated) {
    intervals(lme(fixed, random = ~ 1 | participant, data = rows), which = "fixed")
  } else {
    confint(lm(fixed, data = rows))
  })
  if (!inherits(result, "try-error")) print(result)
}
