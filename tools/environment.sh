# Sourced by the tools: makes the virtual environment .venv and installs the project into it.
# usage: prepare_environment ROOT [EXTRA]   (EXTRA: an optional dependency group of pyproject.toml)

say() { printf '%s\n' "$*" >&2; }

fail() {
    say "$*"
    exit 1
}

find_python() {
    local candidate
    for candidate in python3 python3.14 python3.13 python3.12 python3.11; do
        if command -v "$candidate" >/dev/null 2>&1 &&
            "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    fail "Python 3.11 or later is missing. On Debian: apt-get install python3 python3-venv"
}

make_environment() {
    local python
    python=$(find_python)
    if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        say "The Python module venv is missing."
        if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
            say "Installing python3-venv with apt-get."
            { apt-get update -qq && apt-get install -y -qq python3-venv; } >&2 ||
                fail "apt-get could not install python3-venv."
        else
            fail "On Debian, as root: apt-get install python3-venv"
        fi
    fi
    say "Making the virtual environment .venv"
    "$python" -m venv .venv || fail "The virtual environment .venv could not be made."
}

prepare_environment() {
    # usage: prepare_environment ROOT [EXTRA]
    cd "$1" || fail "$1: no such folder"
    local back=$OLDPWD extra=${2:-} wanted stamp
    [ -x .venv/bin/python ] && .venv/bin/python -c '' 2>/dev/null || make_environment
    stamp=.venv/.installed${extra:+-$extra}
    wanted=$(cat pyproject.toml requirements.lock | cksum)
    # What was installed with an extra holds what is needed without one, and the tests' holds the ARM tools'.
    if [ -z "$extra" ] && grep -qxs -- "$wanted" .venv/.installed*; then
        stamp=
    elif [ "$extra" = arm ] && grep -qxs -- "$wanted" .venv/.installed-test; then
        stamp=
    fi
    if [ -n "$stamp" ] && [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ]; then
        say "Installing what the project needs (once; a few hundred megabytes)"
        .venv/bin/python -m pip install --quiet --disable-pip-version-check \
            --constraint requirements.lock --editable ".${extra:+[$extra]}" >&2 ||
            fail "The installation failed: pip needs a package index it can reach (see its message above)."
        printf '%s\n' "$wanted" >"$stamp"
    fi
    cd "$back" || fail "$back: no such folder"
}
