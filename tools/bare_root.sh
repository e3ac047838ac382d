#!/usr/bin/env bash
# Types the README's lines, as they stand, in a bare Debian root that holds a clone of this checkout, or installs a wheel in a root
# without a compiler and runs the demo. Needs root and debootstrap; mounts vanish with the command; the root stays, to be looked at.
set -euo pipefail

usage="usage: tools/bare_root.sh [--wheel FILE | --test] [--bind FOLDER]... SUITE FOLDER
  SUITE    bookworm, trixie, forky: a Debian
  FOLDER   the root: made by debootstrap if it is not there, otherwise used as it is
  --wheel  install this wheel with --only-binary :all: and no compiler, instead of the README's lines
  --test   type ./setup.sh test too; variables PYTEST_* go along: PYTEST_ADDOPTS=tests/app/test_examples.py for the examples alone
  --bind   a folder of this machine that pip needs in there (wheels, certificates); variables PIP_* go along"

fail() {
  echo "bare_root.sh: $1" >&2
  exit 2
}

wheel='' with_tests='' binds=()
while [[ "${1:-}" == --* ]]; do
  case "$1" in
    --wheel) wheel="$(realpath "$2")" ;;
    --bind) binds+=("$2") ;;
    --test) with_tests=1 ;;
    *) fail "unknown option $1: see the top of this file." ;;
  esac
  [[ "$1" == --test ]] || shift
  shift
done
[[ $# -eq 2 ]] || fail "$usage"
[[ $EUID -eq 0 ]] || fail "chroot needs root: type it with sudo."
suite="$1" root="$2" checkout="$(git -C "$(dirname "${BASH_SOURCE[0]}")" rev-parse --show-toplevel)"

# A private set of mounts: they are gone when the command ends, however it ends.
if [[ -z "${BARE_ROOT_PRIVATE:-}" ]]; then
  again=(${wheel:+--wheel "$wheel"} ${with_tests:+--test})
  for folder in "${binds[@]}"; do again+=(--bind "$folder"); done
  BARE_ROOT_PRIVATE=1 exec unshare --mount --propagation private "${BASH_SOURCE[0]}" "${again[@]}" "$suite" "$root"
fi

# A Debian that this debootstrap does not know yet is made as sid, as all since 2005 are.
script=()
[[ -e "/usr/share/debootstrap/scripts/$suite" ]] || script=(sid)

[[ -d "$root/usr" ]] || debootstrap --variant=minbase "$suite" "$root" http://deb.debian.org/debian "${script[@]}" >"$root.debootstrap.log"
root="$(realpath "$root")"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
for folder in "${binds[@]}"; do
  mkdir -p "$root/$folder"
  mount --bind --read-only "$folder" "$root/$folder"
done

# $1: a line for the shell in the root, shown before it runs as a user would type it.
typed() {
  echo "[$suite] $ $1"
  local variables=(HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8) started=$SECONDS
  mapfile -t -O ${#variables[@]} variables < <(env | grep -E '^(PIP|PYTEST)_' || true)
  env --ignore-environment "${variables[@]}" nice -n 10 chroot "$root" bash -c "cd /home/radiant && $1"
  echo "[$suite] ended well after $((SECONDS - started)) s"
}

# $1: the words that a command of the README's first block begins with. The line as it stands, without its comment.
readme_line() {
  grep --max-count 1 "^    $1" "$checkout/README.md" | sed 's/  *#.*//; s/^ *//'
}

# A window and a server stay until somebody ends them: that they stand for so long is what is seen here.
for_seconds() {
  echo "timeout --signal INT --kill-after 20 $1"
}

readme() {
  rm -rf "$root/home/radiant"
  git clone --quiet --no-hardlinks "$checkout" "$root/home/radiant"
  typed "$(readme_line ./setup.sh)"
  local run inspect
  run="$(readme_line '.venv/bin/radiant run')" inspect="$(readme_line '.venv/bin/radiant inspect')"
  # PHOTOS and system.toml are the reader's.
  run="${run/PHOTOS/sample_scenes/hamlet/images}"
  typed "${run/system.toml/sample_scenes/town/system.toml}"
  typed "xvfb-run --auto-servernum $(for_seconds 20) $inspect || [ \$? = 124 ]"
  typed "$(for_seconds 20) $inspect --web || [ \$? = 124 ]"
  typed "$inspect --screenshot window.png"
  sed -n '/^```python/,/^```/p' "$checkout/README.md" | sed '/^```/d' >"$root/home/radiant/readme.py"
  typed ".venv/bin/python readme.py"
  # The examples, the notebook and these lines of Python are tests among the others.
  [[ -z "$with_tests" ]] || typed "$(readme_line './setup.sh test')"
}

without_compiler() {
  mkdir -p "$root/home/radiant"
  cp "$wheel" "$root/home/radiant"
  typed "apt-get update -qq && apt-get install -qq --yes --no-install-recommends python3-venv ca-certificates libgl1 libegl1 libgomp1 libusb-1.0-0 libglib2.0-0 >/dev/null"
  typed "! command -v cc c++ gcc g++ clang"
  typed "python3 -m venv .venv && .venv/bin/pip install --quiet --only-binary :all: '$(basename "$wheel")[sfm]'"
  typed ".venv/bin/radiant demo"
}

if [[ -n "$wheel" ]]; then without_compiler; else readme; fi
