# A bandit with a table: the mean reward of every action in the likelier context, with epsilon-greedy choices.
# The first entry of an observation must be the probability of context 0 (P) or the context itself (C, L).

# The value under a name, or the first number of its lists.
function field(name,    rest) {
    rest = $0
    sub(".*\"" name "\":\\[*", "", rest)
    sub(/[],}].*/, "", rest)
    return rest
}

function say(line) {
    print line
    fflush()
}

function context_of(entry) {
    return scenario ~ /^"P/ ? (entry < 0.5) : (entry >= 0.5)
}

function best(context,    action, found) {
    found = 0
    for (action = 1; action < 4; action++)
        if (mean[context, action] > mean[context, found])
            found = action
    return found
}

function step(entry) {
    context = context_of(entry)
    action = rand() < epsilon ? int(4 * rand()) : best(context)
    say("{\"type\":\"step\",\"actions\":[" action "]}")
}

/"type":"job"/ {
    scenario = field("scenario")
    budget = field("episodes") + 0
    epsilon = field("epsilon") + 0
    srand(field("seed") + 0)
    say("{\"type\":\"ready\",\"protocol\":1}")
    say("{\"type\":\"reset\"}")
}

/"type":"began"/ { step(field("observations") + 0) }

/"type":"stepped"/ {
    count[context, action]++
    mean[context, action] += (field("rewards") - mean[context, action]) / count[context, action]
    if (field("terminated") == "false" && field("truncated") == "false")
        step(field("observations") + 0)
    else if (++episodes < budget)
        say("{\"type\":\"reset\"}")
    else
        say("{\"type\":\"trained\"}")
}

/"type":"act"/ {
    rows = $0
    sub(/.*"observations":\[\[/, "", rows)
    sub(/\]\].*/, "", rows)
    lanes = split(rows, row, /\],\[/)
    chosen = ""
    for (lane = 1; lane <= lanes; lane++)
        chosen = chosen (lane > 1 ? "," : "") best(context_of(row[lane] + 0))
    say("{\"type\":\"choices\",\"actions\":[" chosen "]}")
}

/"type":"end"/ { exit }
