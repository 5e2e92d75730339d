# What the test scripts share; sourced by them, from the repository's root.

# On a machine that others use too a process may wait some seconds for a core: none is taken for lost for that, neither motion by the robot, nor the
# robot by motion, nor either by the network. No test of these scripts is about how soon that is.
export REPOSE_MOTION__COMMAND_TTL_MS=10000 REPOSE_MOTION__ROBOT_SILENCE_MS=10000 REPOSE_SESSION__LEASE_MS=10000

# Sets and exports REPOSE, the program to test: the one that it names, else this build's.
find_program() {
    if [ -z "${REPOSE:-}" ]; then
        # Of the whole workspace, as `cargo test --workspace` resolves it: so nothing is compiled twice.
        cargo build --workspace --release --locked --bin repose
        REPOSE="${CARGO_TARGET_DIR:-target}/release/repose"
    fi
    REPOSE="$(realpath "$REPOSE")"
    export REPOSE
}

# A fresh virtual environment, `$environment`, with what pip is told to install; gone when the script ends.
# `PYTHON=python3.12 scripts/…` makes it of another interpreter.
make_environment() {
    environment="$(mktemp -d)"
    trap 'rm -rf "$environment"' EXIT
    "${PYTHON:-python3}" -m venv "$environment"
    "$environment/bin/pip" install --quiet --disable-pip-version-check "$@"
}

# Installs packages of Debian.
install_packages() {
    as_root apt-get update -qq && as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
