#!/bin/sh
# Shards of one run as an array of Slurm: job N simulates the SIZE trials from N * SIZE on, into FOLDER/N.
#     sbatch --array=0-3 shards.sh SIZE FOLDER OVERRIDES...
#SBATCH --cpus-per-task=1
#SBATCH --time=1:00:00
#SBATCH --signal=B:TERM@120
#SBATCH --requeue
size=$1 folder=$2
shift 2
exec python -m snnrl.run "$@" trials="$size" trial_start=$((size * SLURM_ARRAY_TASK_ID)) \
    threads="$SLURM_CPUS_PER_TASK" hydra.run.dir="$folder/$SLURM_ARRAY_TASK_ID"
