#!/usr/bin/env bash
# Smoke test: starts a welkin binary on a free loopback port, asks it for its health, its worlds, its page and a picture,
# and stops it.
#
#   deploy/smoke.sh [BINARY]            default: target/release/welkin
#   deploy/smoke.sh --url http://HOST:PORT    tests a server that runs already, and leaves it running
#
# Needs bash and curl.
set -euo pipefail

work=$(mktemp -d)
server_pid=""

finish() {
  local status=$?
  if [[ -n $server_pid ]]; then
    kill -INT "$server_pid" 2>/dev/null || true
    for _ in $(seq 100); do
      kill -0 "$server_pid" 2>/dev/null || break
      sleep 0.1
    done
    if kill -KILL "$server_pid" 2>/dev/null; then
      echo "smoke: the server did not stop within 10 s of Ctrl-C" >&2
      [[ $status -ne 0 ]] || status=1
    fi
    wait "$server_pid" 2>/dev/null || true
  fi
  if [[ $status -ne 0 && -s $work/server.log ]]; then
    echo "--- the server's log, last lines" >&2
    tail -n 40 "$work/server.log" >&2
  fi
  rm -rf "$work"
  exit "$status"
}
trap finish EXIT

fail() {
  echo "smoke: $*" >&2
  exit 1
}

get() { # PATH FILE: the answer into the file; the status must be 200
  local status
  status=$(curl --silent --show-error --max-time 60 --output "$2" --write-out '%{http_code}' "$url$1") ||
    fail "GET $1 did not come through"
  [[ $status == 200 ]] || fail "GET $1 answered $status: $(head -c 300 "$2")"
}

if [[ ${1:-} == --url ]]; then
  url=${2:?--url needs an address}
  url=${url%/}
else
  binary=${1:-target/release/welkin}
  [[ -x $binary ]] || fail "no program at $binary; cargo build --release makes it"
  # A port that nobody listens on; should somebody take it meanwhile, another is tried.
  for attempt in 1 2 3 4 5; do
    port=$((20000 + (RANDOM * 32768 + RANDOM) % 30000))
    if (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; then
      continue
    fi
    "$binary" serve --listen "127.0.0.1:$port" >"$work/server.log" 2>&1 &
    server_pid=$!
    url=http://127.0.0.1:$port
    started=$(date +%s%N)
    for _ in $(seq 300); do
      if curl --silent --fail --max-time 2 --output /dev/null "$url/healthz"; then
        echo "smoke: healthy after $((($(date +%s%N) - started) / 1000000)) ms"
        break 2
      fi
      kill -0 "$server_pid" 2>/dev/null || break
      sleep 0.1
    done
    if kill -0 "$server_pid" 2>/dev/null; then
      fail "not healthy within 30 s"
    fi
    server_pid=""
    [[ $attempt -lt 5 ]] || fail "the server did not start"
  done
fi

get /healthz "$work/health"
get /v1/worlds "$work/worlds"
id=$(grep -o '"id": *"[^"]*"' "$work/worlds" | head -n 1 | cut -d'"' -f4) || fail "no world runs: $(head -c 300 "$work/worlds")"
get / "$work/page"
grep -qi '<!doctype html' "$work/page" || fail "/ is no page"

started=$(date +%s%N)
get "/v1/worlds/$id/frame?width=320&height=180&format=png" "$work/frame"
took=$((($(date +%s%N) - started) / 1000000))
[[ $(head -c 8 "$work/frame" | od -An -tx1 | tr -d ' \n') == 89504e470d0a1a0a ]] || fail "the frame is no PNG"
bytes=$(stat -c %s "$work/frame")
# A picture of one colour packs into a few hundred bytes.
[[ $bytes -gt 2000 ]] || fail "the frame has $bytes bytes: it is blank"

get "/v1/worlds/$id/volume.bin?channels=temperature_k&mip=2" "$work/volume"
[[ $(head -c 4 "$work/volume") == WLKV ]] || fail "the volume is none: $(head -c 300 "$work/volume")"

tick() { curl --silent --fail --max-time 10 "$url/v1/worlds/$id" | grep -o '"tick": *[0-9]*' | head -n 1 | grep -o '[0-9]*'; }
first=$(tick) || fail "the world says no tick"
for _ in $(seq 100); do
  sleep 0.2
  now=$(tick) || fail "the world says no tick"
  [[ $now -le $first ]] || break
done
[[ $now -gt $first ]] || fail "the tick stands at $now"

status=$(curl --silent --max-time 10 --output "$work/refusal" --write-out '%{http_code}' "$url/v1/worlds/$id/frame?width=0&height=0")
[[ $status == 4?? ]] || fail "a frame of 0x0 was answered with $status"

echo "smoke: world $id ticks, a 320x180 frame of $bytes bytes took $took ms; all is well"
