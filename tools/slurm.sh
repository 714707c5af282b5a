#!/bin/sh
# Slurm on this machine alone, for as long as a command takes; needs root, and Debian's slurm-wlm and munge.
#     tools/slurm.sh python -m pytest tests/test_slurm.py
set -eu
place=$(mktemp -d)
host=$(hostname -s)
cat > "$place/slurm.conf" <<END
ClusterName=here
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
StateSaveLocation=$place
SlurmdSpoolDir=$place
SlurmctldPidFile=$place/slurmctld.pid
SlurmdPidFile=$place/slurmd.pid
SlurmctldLogFile=$place/slurmctld.log
SlurmdLogFile=$place/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
ReturnToService=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc --all) RealMemory=4000
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END
end() {
    for daemon in slurmd slurmctld munged; do
        [ -f "$place/$daemon.pid" ] || continue
        number=$(cat "$place/$daemon.pid")
        kill "$number" || true
        while kill -0 "$number" 2> /dev/null; do sleep 0.2; done
    done
    rm -rf "$place"
}
trap end EXIT
trap 'exit 143' INT TERM
dd if=/dev/urandom of="$place/key" bs=1 count=1024 2> "$place/dd.log"
chmod 400 "$place/key"
chmod 711 "$place"
munged --force --key-file "$place/key" --socket "$place/munge" --pid-file "$place/munged.pid" --log-file "$place/munged.log" \
    --seed-file "$place/munged.seed"
echo "AuthInfo=socket=$place/munge" >> "$place/slurm.conf"
export SLURM_CONF="$place/slurm.conf"
slurmctld
sleep 2
slurmd
until sinfo --noheader --states=idle | grep --quiet all; do sleep 1; done
"$@"
