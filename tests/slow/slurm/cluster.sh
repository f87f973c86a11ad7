#!/usr/bin/env bash
# A throw-away Slurm cluster on loopback, without systemd: munged, slurmctld and three slurmd.
#
#   cluster.sh up FOLDER PORT       brings it up; FOLDER/slurm.conf is its SLURM_CONF
#   cluster.sh down FOLDER          ends what `up` started
#   cluster.sh kill-node FOLDER N   cuts the power of node nN
#   cluster.sh start-node FOLDER N  powers it on again
#   cluster.sh kill-controller FOLDER, cluster.sh start-controller FOLDER
#
# A node has a PID namespace of its own, so that everything on it dies with one process.
# As root: namespaces and Slurm's daemons need it.
set -euo pipefail

nodes=3
cpus=${SLURM_TEST_CPUS:-4}
max_array_size=${SLURM_TEST_MAX_ARRAY_SIZE:-1001}

configure() {
    local port=$1 host
    host=$(hostname -s)
    cat >"$folder/slurm.conf" <<CONF
ClusterName=loopback
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
SlurmUser=root
AuthType=auth/munge
CredType=cred/munge
# A requeued job waits until its credential has expired, two minutes by default.
AuthInfo=socket=$folder/munge.sock,cred_expire=5
StateSaveLocation=$folder/state
SlurmctldPidFile=$folder/slurmctld.pid
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdPidFile=$folder/slurmd.%n.pid
SlurmdLogFile=$folder/log/slurmd.%n.log
SlurmdSpoolDir=$folder/spool/%n
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=2,sched_min_interval=0,bf_interval=5
ReturnToService=2
SlurmctldTimeout=30
SlurmdTimeout=30
MessageTimeout=20
BatchStartTimeout=20
KillWait=20
MinJobAge=300
JobRequeue=1
MaxArraySize=$max_array_size
MaxJobCount=10000
SlurmdParameters=config_overrides
PropagateResourceLimits=NONE
CONF
    for number in $(seq "$nodes"); do
        echo "NodeName=n$number NodeHostname=$host NodeAddr=127.0.0.1 Port=$((port + number))" \
            "CPUs=$cpus RealMemory=10000 State=UNKNOWN" >>"$folder/slurm.conf"
    done
    echo "PartitionName=main Nodes=n[1-$nodes] Default=YES MaxTime=INFINITE State=UP" \
        >>"$folder/slurm.conf"
    # Never touch the machine's control groups.
    printf 'CgroupAutomount=no\nCgroupPlugin=cgroup/v1\nConstrainCores=no\nConstrainRAMSpace=no\n' \
        >"$folder/cgroup.conf"
}

# Starts a daemon and records its process under a name.
start() {
    local name=$1
    shift
    setsid "$@" >>"$folder/log/$name.out" 2>&1 </dev/null &
    echo $! >"$folder/process/$name"
}

# Ends a recorded process, if its environment shows that it is the process that was started.
end() {
    local name=$1 signal=$2 process
    [ -e "$folder/process/$name" ] || return 0
    process=$(cat "$folder/process/$name")
    rm "$folder/process/$name"
    if tr '\0' '\n' <"/proc/$process/environ" 2>/dev/null | grep -qx "SLURM_CONF=$SLURM_CONF"; then
        kill "-$signal" "$process" 2>/dev/null || true
        for _ in $(seq 200); do
            [ -e "/proc/$process" ] || return 0
            sleep 0.05
        done
        kill -9 "$process" 2>/dev/null || true
    fi
}

start_node() {
    mkdir -p "$folder/spool/n$1"
    start "slurmd-n$1" unshare --pid --fork --mount-proc --kill-child=SIGKILL \
        bash -c 'slurmd -D -N "$0" -f "$1" & wait $!' "n$1" "$SLURM_CONF"
}

start_controller() {
    start slurmctld slurmctld -D -f "$SLURM_CONF"
}

up() {
    mkdir -p "$folder"/{state,log,spool,process}
    chmod 755 "$folder" "$folder"/*
    configure "$1"
    (umask 077 && head -c 128 /dev/urandom >"$folder/munge.key")
    start munged munged --foreground --force --socket="$folder/munge.sock" \
        --key-file="$folder/munge.key" --pid-file="$folder/munged.pid" \
        --seed-file="$folder/munge.seed" --log-file="$folder/log/munged.log" --num-threads=2
    for _ in $(seq 200); do
        [ -S "$folder/munge.sock" ] && break
        sleep 0.05
    done
    start_controller
    for number in $(seq "$nodes"); do
        start_node "$number"
    done
    for _ in $(seq 600); do
        idle=$(sinfo --noheader --Node --states=idle --format=%N 2>/dev/null | sort -u | wc -l || true)
        [ "$idle" -eq "$nodes" ] && return 0
        sleep 0.2
    done
    echo "Slurm did not come up; its logs:" >&2
    tail -n 20 "$folder"/log/* >&2
    return 1
}

down() {
    for number in $(seq "$nodes"); do
        end "slurmd-n$number" KILL
    done
    end slurmctld KILL
    end munged TERM
}

command=$1
folder=$(realpath -m "$2")
export SLURM_CONF=$folder/slurm.conf
shift 2
case $command in
up) up "$1" ;;
down) down ;;
kill-node) end "slurmd-n$1" KILL ;;
start-node) start_node "$1" ;;
kill-controller) end slurmctld KILL ;;
start-controller) start_controller ;;
*)
    sed -n '2,12s/^# \{0,1\}//p' "$0" >&2
    exit 2
    ;;
esac
