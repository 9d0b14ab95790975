#!/usr/bin/env bash
# The commands that made the policies in this folder, about 100 minutes in all on two cores.
# Usage: garage/train.sh [rookie racer dodger duelist globetrotter ...]
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_WAIT_POLICY=PASSIVE
league=.venv/bin/league

rookie() {  # the classic reward at walking pace: laps in well under a minute
    "$league" train --out garage/rookie.pt --reward centerline --action-space 0.5-1 \
        --num-worlds 32 --rollout 32 --mini-batches 8 --minutes 1 --stop-when-complete 2 --seed 1 --plain
}
racer() {  # time trial: as fast as it dares
    "$league" train --out garage/racer.pt --action-space 1-4 --minutes 15 --noise 0.5 0.05 \
        --rollout 32 --mini-batches 8 --seed 1 --plain
}
dodger() {  # six boxes at random places
    "$league" train --out garage/dodger.pt --kind obstacle_avoidance --action-space 0.5-3 \
        --minutes 10 --exam-trials 8 --exam-every 2 --seed 1 --plain
}
duelist() {  # the racer, after half an hour of racing its own past and slower cars
    "$league" train --out garage/duelist.pt --kind head_to_head --self-play \
        --init-from garage/racer.pt --reward race --action-space 1-4 --minutes 25 \
        --noise 0.4 0.06 --scripted-share 0.4 --random-cars --car-spread 0.15 \
        --exam-every 8 --seed 1 --plain
}
globetrotter() {  # random tracks only, with random cars and looks: drives any track at first sight
    "$league" train --out garage/globetrotter.pt --track generated:768 --action-space 0.5-3 \
        --num-worlds 128 --random-cars --random-looks --minutes 30 --noise 0.5 0.1 \
        --exam-every 2 --seed 1 --plain
}

for policy in "${@:-rookie racer dodger duelist globetrotter}"; do
    for name in $policy; do "$name"; done
done
