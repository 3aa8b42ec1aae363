#!/usr/bin/env bash
# Runs all recordings of a folder on the machines that SLURM gives:
#   sbatch --nodes 4 docs/cluster/slurm.sh /data/drives /data/results
# Both folders are on a file system of all machines, as are `vo`, Ray and ~/.ray/auth_token
# (ray get-auth-token --generate). Submitted again, it goes on where it was stopped.
#SBATCH --job-name=vo
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=16
#SBATCH --time=08:00:00
set -euo pipefail
recordings=$1 results=$2
first=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
# Starts Ray on every machine, and the command on the first one when all have joined.
srun ray symmetric-run \
  --address "$first:6379" \
  --min-nodes "$SLURM_JOB_NUM_NODES" \
  --num-cpus "$SLURM_CPUS_PER_TASK" \
  -- vo batch "$recordings" --output "$results" --ray auto
