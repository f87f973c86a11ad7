#!/bin/sh
# How much eight readers slow a sweep of two workers down: the same sweep, alone and with
# readers that ask again every so often, in turns. Prints a line a pair, and the median ratio.
#
# JITAI: the program. PAIRS: how often. READERS: how many. PAUSE: seconds between two questions of
# a reader.
set -eu
: "${JITAI:=target/release/jitai}" "${PAIRS:=5}" "${PAUSE:=1}" "${READERS:=8}"
JITAI=$(realpath "$JITAI")
place=$(mktemp -d)
# Whatever ends this, the readers end first.
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

# Asks until there is a file `over`; a dot in `asked` for each answer, a line in `failed` for each
# question without one. Every other reader asks for the state of the sweep, as `status` shows it.
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

# Seconds that the sweep takes with so many readers.
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
