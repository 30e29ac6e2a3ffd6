#!/bin/bash
# Serve, bring one benchmark to its end, write its archive: benchmark.sh benchmark.json DATA_DIR
#
# On a machine of a Ray cluster. Run again, it goes on where it was stopped.
set -euo pipefail

benchmark=$1
export ADR_DATA_DIR=$2 ADR_RAY_ADDRESS=${ADR_RAY_ADDRESS:-auto}

adr serve &
service=$!
trap 'kill -TERM $(jobs -p) 2>/dev/null; wait' EXIT
trap 'exit 143' TERM
until adr list >/dev/null 2>&1; do
    kill -0 "$service" # it has not ended
    sleep 2
done
echo "serving on $(hostname): ssh -L 8000:127.0.0.1:${ADR_PORT:-8000} $(hostname)"

if [[ ! -s $ADR_DATA_DIR/benchmark ]]; then
    adr submit "$benchmark" --json >"$ADR_DATA_DIR/submitted.json"
    python -c 'import json, sys; print(json.load(sys.stdin)["id"])' \
        <"$ADR_DATA_DIR/submitted.json" >"$ADR_DATA_DIR/benchmark"
fi
id=$(<"$ADR_DATA_DIR/benchmark")
adr watch "$id" & # a signal ends `wait`, and would not end a command
wait $!
adr archive export "$id" "$ADR_DATA_DIR/results.adr"
