#!/usr/bin/env bash
# Sets Radiant up in .venv beside this file and runs one of its commands. A finished set-up is not done again.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

usage="usage: ./setup.sh [demo|test|check|clang|help]
  (nothing)  set up and stop
  demo       set up, reconstruct a sample scene and name the report
  test       set up with everything the tests use, then run the checks and the tests
  check      the checks alone: import rules, linter, types
  clang      set up, build the native module with clang too, and run the contract of the rasterizers on it
  help       this text"

# Headers and a compiler for the native module; GL, EGL, Vulkan and a display for pictures; the libraries that Qt loads.
system_packages=(
  python3 python3-dev python3-venv g++ ca-certificates
  libgl1 libegl1 libgomp1 libusb-1.0-0 libvulkan1 mesa-vulkan-drivers xvfb xauth
  libdbus-1-3 libfontconfig1 libglib2.0-0 libxcb-cursor0 libxcb-icccm4 libxcb-image0 libxcb-keysyms1 libxcb-render-util0
  libxcb-shape0 libxkbcommon-x11-0
)

# Structure from motion, what a surveyor exports, and the window and the page of `radiant inspect` come with every set-up.
everyday=desktop,flip,geo,sfm,survey,web

fail() {
  echo "setup.sh: $1" >&2
  exit 2
}

install_system_packages() {
  command -v dpkg-query >/dev/null || fail "this is not a Debian system: install the counterparts of ${system_packages[*]} and delete this check."
  local missing=() package
  for package in "${system_packages[@]}"; do
    [[ "$(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null)" == installed ]] || missing+=("$package")
  done
  [[ ${#missing[@]} -eq 0 ]] && return
  local line="apt-get update && apt-get install --yes --no-install-recommends ${missing[*]}"
  [[ $EUID -eq 0 ]] || fail "system packages are missing; run this line as root, then ./setup.sh again:
$line"
  echo "setup.sh: $line"
  apt-get update
  DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends "${missing[@]}"
}

# A browser drives the web page in a test, which is skipped without one: nothing here ends the command.
install_chromium() {
  command -v chromium >/dev/null && return
  local line="apt-get update && apt-get install --yes --no-install-recommends chromium"
  if [[ $EUID -ne 0 ]]; then
    echo "setup.sh: there is no chromium, so the test of the web page will be skipped; as root: $line"
    return
  fi
  echo "setup.sh: $line"
  { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends chromium; } ||
    echo "setup.sh: chromium was not installed, so the test of the web page will be skipped"
}

# What the environment was made from: if this text is the same, there is nothing to install.
fingerprint() {
  echo "$PWD $(.venv/bin/python -VV 2>&1)"
  # The installation knows a module by its file: one that became a folder is looked for in vain.
  find core viewer radiant_app radiant -name __init__.py | sort
  find pyproject.toml CMakeLists.txt core/radiant_core/native benchmarks/native -type f -exec sha256sum {} + | sort -k 2
}

# pip leaves half a package behind when it is killed, so an environment whose installation did not end is made anew.
make_environment() {
  if [[ ! -e .venv/installing ]] && .venv/bin/python -m pip --version >/dev/null 2>&1; then return; fi
  python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "$(python3 --version) is too old: Python 3.11 or newer is needed."
  echo "setup.sh: making the virtual environment in $PWD/.venv"
  rm -rf .venv
  mkdir .venv
  touch .venv/installing
  python3 -m venv .venv
}

# Sizes with torch's CPU build, of the wheels and of what their RECORD files list; minutes on two cores with nothing beside.
say_what_comes() {
  local on_disk=3.4
  [[ "$1" == test ]] && on_disk=4.4
  echo "setup.sh: this installs into .venv: 1.1 GB or more to download (more where torch brings CUDA), $on_disk GB on disk; about 5 minutes,
  longer on busy cores. pip is silent while it compiles the C++ module (\"Building editable\", 1.5 minutes: rasterizer, training,
  matching, planner) and while it writes the packages (\"Installing collected packages\")."
}

# $1: extras of pyproject.toml; the tests' have the everyday ones among them.
install_project() {
  exec 9<.
  flock 9
  if [[ "$(cat ".venv/installed-$1" 2>/dev/null)" != "$(fingerprint 2>/dev/null)" || -e .venv/installing ]]; then
    install_system_packages
    say_what_comes "$1"
    make_environment
    touch .venv/installing
    .venv/bin/python -m pip install --editable ".[$1]"
    fingerprint | tee ".venv/installed-$1" >".venv/installed-$everyday"
    rm .venv/installing
  fi
  exec 9<&-
}

install_clang() {
  command -v clang++ >/dev/null && return
  local line="apt-get update && apt-get install --yes --no-install-recommends clang"
  [[ $EUID -eq 0 ]] || fail "there is no clang; run this line as root, then ./setup.sh clang again:
$line"
  echo "setup.sh: $line"
  apt-get update
  DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends clang
}

# A wheel in a folder of its own: the environment keeps what its own compiler made.
build_with_clang() {
  [[ "$(cat build/clang/made-of 2>/dev/null)" != "$(fingerprint)" ]] || return 0
  rm -rf build/clang
  mkdir -p build/clang
  CC=clang CXX=clang++ .venv/bin/python -m pip wheel --quiet --no-deps --wheel-dir build/clang --config-settings=build-dir=build/clang/cmake .
  .venv/bin/python -m zipfile --extract build/clang/*.whl build/clang/packages
  fingerprint >build/clang/made-of
}

# -S: otherwise the editable installation would come before what clang made.
run_contract_of_clang() {
  local installed
  installed="$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"
  export PYTHONPATH="$PWD/build/clang/packages:$installed"
  .venv/bin/python -S -c 'from radiant_core import _native as n; print("setup.sh:", n.compiler()); assert n.compiler().startswith("clang")'
  .venv/bin/python -S -m pytest tests/contract/test_rasterizers.py tests/contract/test_absgrad.py -p no:cacheprovider
}

# Types take one core most of this time; they are told last.
run_checks() {
  local types ended=0
  .venv/bin/pyright &
  types=$!
  { .venv/bin/lint-imports && .venv/bin/ruff check && .venv/bin/ruff format --check --quiet; } || ended=$?
  wait "$types" || ended=$?
  return "$ended"
}

[[ $# -le 1 ]] || fail "one argument at most, got $#: $*. Try ./setup.sh help."
case "${1:-}" in
  "")
    install_project "$everyday"
    echo "setup.sh: done; try .venv/bin/radiant --help"
    ;;
  demo)
    install_project "$everyday"
    exec .venv/bin/radiant demo
    ;;
  check)
    install_project test
    run_checks
    ;;
  test)
    install_project test
    install_chromium
    run_checks
    # Where it is set, every process that a test starts compiles what it imports of the project again, a worker for 0.7 s of CPU time.
    unset PYTHONDONTWRITEBYTECODE
    # Two at a time even on larger machines: a worker holds up to 2 GB.
    # The import rules are checked already.
    .venv/bin/python -m pytest -n 2 --dist loadfile --deselect tests/architecture/test_imports.py::test_import_linter_keeps_every_contract
    ;;
  clang)
    install_project test
    install_clang
    build_with_clang
    run_contract_of_clang
    ;;
  help | --help | -h) echo "$usage" ;;
  *) fail "unknown argument '$1'. Try ./setup.sh help." ;;
esac
