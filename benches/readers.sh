#!/bin/sh
# Slowdown of a sweep of two workers by eight readers. Runs the same sweep alternately alone and with
# readers that repeat their query at intervals. Prints a line per pair, and the median ratio.
#
# JITAI: the program. PAIRS: number of pairs. READERS: number of readers. PAUSE: seconds between two
# queries of a reader.
set -eu
: "${JITAI:=target/release/jitai}" "${PAIRS:=5}" "${PAUSE:=1}" "${READERS:=8}"
JITAI=$(realpath "$JITAI")
place=$(mktemp -d)
# However the script ends, the readers end first.
trap 'touch "$place/over"; wait; rm -rf "$place"' EXIT
trap 'exit 130' INT TERM
cd "$place"
cat > sweep.toml <<'END'
format = 1
name = "sweep"
scenarios = ["P-H-D"]
seeds = 6
environment.sigma = 0.6
[[agent]]
name = "dqn"
algorithm = "dueling_dqn"
[[agent]]
name = "reinforce"
algorithm = "reinforce"
END

# Queries until the file `over` exists. Writes a dot to `asked` for each answer, and a line to `failed`
# for each query without an answer. Every other reader runs `status` instead of the query.
reader() {
    while [ ! -e over ]; do
        if [ $(($1 % 2)) -eq 0 ]; then
            "$JITAI" query "SELECT agent, count(*), avg(mean_return) FROM run_summary GROUP BY agent"
        else
            "$JITAI" status
        fi > /dev/null 2>> failed && printf . >> asked || echo "reader $1 got no answer" >> failed
        sleep "$PAUSE"
    done
}

quotient() {
    awk "BEGIN { printf \"%.3f\", $1 / $2 }"
}

# The duration of the sweep in seconds, with this number of readers.
sweep() {
    rm -f jitai.sqlite* over
    begun=$(date +%s%N)
    "$JITAI" run sweep.toml --workers 2 --quiet > said 2>&1 &
    run=$!
    until [ -e jitai.sqlite ] && "$JITAI" status > /dev/null 2>&1; do
        kill -0 "$run" 2> /dev/null || { cat said >&2; exit 1; }
        sleep 0.01
    done
    number=0
    while [ "$number" -lt "$1" ]; do
        number=$((number + 1))
        reader "$number" &
    done
    wait "$run" || { cat said >&2; exit 1; }
    ended=$(date +%s%N)
    touch over
    wait
    seconds=$(quotient $((ended - begun)) 1000000000)
}

: > failed
: > ratios
pair=0
while [ "$pair" -lt "$PAIRS" ]; do
    pair=$((pair + 1))
    : > asked
    sweep 0
    alone=$seconds
    sweep "$READERS"
    ratio=$(quotient "$seconds" "$alone")
    echo "$ratio" >> ratios
    echo "alone $alone s, with $READERS readers $seconds s: $ratio ($(wc -c < asked) answers)"
done
echo "median ratio $(sort -n ratios | sed -n "$(((PAIRS + 1) / 2))p"), $(wc -l < failed) failures"
[ ! -s failed ] || { head -5 failed >&2; exit 1; }
