#!/bin/bash
# Serve, bring one benchmark to its end, write its archive: benchmark.sh benchmark.json DATA_DIR
#
# On a machine of a Ray cluster. Run again, it goes on where it was stopped, and tries again what
# has failed. DATA_DIR has one archive for each content of such a file. To submit one anew, delete its
# .id and .key there.
set -euo pipefail

benchmark=$1
sum=$(sha256sum "$benchmark")
name=$2/$(basename "$benchmark" .json)-${sum:0:8}
export ADR_DATA_DIR=$2 ADR_RAY_ADDRESS=${ADR_RAY_ADDRESS:-auto}
unset ADR_URL # of another service, which would get the benchmark

adr serve &
service=$!
trap 'kill -TERM $(jobs -p) 2>/dev/null; wait' EXIT
trap 'exit 143' TERM
until adr list >/dev/null 2>&1; do
    kill -0 "$service" # it has not ended
    sleep 2
done
kill -0 "$service" # it is what has answered
echo "serving on $(hostname): ssh -L 8000:127.0.0.1:${ADR_PORT:-8000} $(hostname)"

if [[ -s $name.id ]]; then
    adr resume "$(<"$name.id")"
else
    # under its key nothing is submitted twice within a day, as by a job that is stopped here
    [[ -s $name.key ]] || python -c 'import uuid; print(uuid.uuid4())' >"$name.key"
    adr submit "$benchmark" --key "$(<"$name.key")" --json >"$name.submitted"
    python -c 'import json, sys; print(json.load(sys.stdin)["id"])' <"$name.submitted" >"$name.id"
fi
id=$(<"$name.id") status=0
adr watch "$id" & # a signal ends `wait`, and would not end a command
wait $! || status=$?
rm -f "$name.new.adr"
adr archive export "$id" "$name.new.adr"
mv -f "$name.new.adr" "$name.adr"
exit "$status"
