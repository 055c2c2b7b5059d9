#!/usr/bin/env bash
# A sweep over the nodes of a Slurm job: sbatch experiments/sweep/slurm.sh GRID RUNS
#
# A Ray cluster is started over the nodes, and the sweep runs on it. Five minutes before its time
# is over, and when it is preempted, the job is told with SIGUSR1 (or SIGTERM): every training saves
# and ends, and the job puts itself into the queue again, where the sweep goes on.
#SBATCH --job-name=fbrl-sweep
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=32
#SBATCH --exclusive
#SBATCH --time=24:00:00
#SBATCH --signal=B:USR1@300
#SBATCH --requeue
#SBATCH --open-mode=append

set -euo pipefail

GRID=${1:-experiments/sweep/grid.yaml}
RUNS=${2:-runs/sweep}
CPUS_PER_RUN=${CPUS_PER_RUN:-4}
# One of its own for each job: two of them may be on the same node.
PORT=${PORT:-$((20000 + SLURM_JOB_ID % 10000))}

# A step takes the CPUs of the job only if it is told so, since Slurm 22.05.
step=(srun --ntasks-per-node=1 --cpus-per-task="$SLURM_CPUS_PER_TASK")

# The script runs on the first node of the job; of several addresses the first of IPv4 is taken.
head_node=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
head_address=$(hostname --ip-address | tr ' ' '\n' | grep -m 1 -F .)
export RAY_ADDRESS="$head_address:$PORT"

# Ray's ports are open to the network of the cluster: use one that is trusted.
"${step[@]}" --nodes=1 --nodelist="$head_node" \
    ray start --head --node-ip-address="$head_address" --port="$PORT" \
    --num-cpus="$SLURM_CPUS_PER_TASK" --include-dashboard=false --disable-usage-stats --block &
for ((attempt = 0; attempt < 60; attempt++)); do
    if ray status --address "$RAY_ADDRESS" >/dev/null 2>&1; then break; fi
    sleep 2
done
ray status --address "$RAY_ADDRESS"
# The sweep begins on the nodes that are there, and takes the others as they come.
if [ "$SLURM_JOB_NUM_NODES" -gt 1 ]; then
    "${step[@]}" --nodes=$((SLURM_JOB_NUM_NODES - 1)) --exclude="$head_node" \
        ray start --address="$RAY_ADDRESS" --num-cpus="$SLURM_CPUS_PER_TASK" --block &
fi

python experiments/sweep/run.py "$GRID" "$RUNS" --cpus-per-run "$CPUS_PER_RUN" &
sweep=$!
trap 'kill -USR1 $sweep' USR1 TERM

# A signal ends `wait` before the sweep has ended.
code=0
while kill -0 $sweep 2>/dev/null; do
    code=0
    wait $sweep || code=$?
done
if [ $code -eq 130 ]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit $code
