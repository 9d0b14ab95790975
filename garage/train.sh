#!/usr/bin/env bash
# The commands that made the policies in this folder, about two and a half hours in all, each on one core.
# Usage: garage/train.sh [rookie racer dodger novice duelist globetrotter ...]
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_WAIT_POLICY=PASSIVE

train() {  # train NAME FLAG ...: train a policy into this folder
    local name=$1
    shift
    [[ " $* " == *" --seed "* ]] || set -- --seed 1 "$@"
    .venv/bin/league train --out "garage/$name.pt" --overwrite --plain "$@"
}
rookie() {  # the classic reward at walking pace: laps in well under a minute
    train rookie --reward centerline --action-space 0.5-1 --num-worlds 16 \
        --minutes 1 --stop-when-complete 2
}
racer() {  # time trial: as fast as it dares, then for eight minutes with mistakes that cost more
    local line=(--seed 3 --action-space 1-4 --reward racing_line --gamma 0.98 --lam 0.95
        --eval-every 2 --dynamics-randomization 1)
    train racer "${line[@]}" --minutes 15 --teacher 0.4 --bootstrap-on-failure \
        --noise 0.4 0.03 --learning-rate 0.002 0.00005
    train racer "${line[@]}" --minutes 8 --init-from garage/racer.pt \
        --noise 0.15 0.03 --learning-rate 0.0005 0.00005
}
dodger() {  # six boxes at random places
    train dodger --kind obstacle_avoidance --action-space 0.5-3 --minutes 14 \
        --dynamics-randomization 1 --noise 0.4 0.03 --learning-rate 0.002 0.00005 \
        --eval-trials 8 --eval-every 4
}
novice() {  # a minute of time trial
    train novice --seed 2 --action-space 1-4 --minutes 1
}
duelist() {  # wheel to wheel: on the true state, then with cameras, lidar and a short memory
    train duelist --seed 3 --kind head_to_head --self-play --cars 4 --teacher 0.8696 \
        --steps 41400000 --threads 1 --sensors stereo64x48 discretised16x8@1 history4 frames2 \
        --eval-every 10
}
globetrotter() {  # random tracks only, with random cars and looks: drives any track at first sight
    train globetrotter --track generated:768 --action-space 0.5-3 --num-worlds 128 \
        --dynamics-randomization 1 --visual-randomization --minutes 40 --noise 0.5 0.05 --eval-every 4
}

for policy in "${@:-rookie racer dodger novice duelist globetrotter}"; do
    for name in $policy; do "$name"; done
done
