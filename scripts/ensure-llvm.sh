#!/bin/sh
# Make sure that Dr.Jit finds an LLVM it can use; without one designlab renders with scalar_rgb, only slower.
set -eu
cd "$(dirname "$0")/.."

has_usable_back_end() {
    .venv/bin/python -c \
        'import sys; from designlab.core.backend import choose; sys.exit(not choose().is_jit)' 2>/dev/null
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    else
        sudo -n "$@"
    fi
}

apt_get() {
    as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq -y \
        -o Acquire::http::Timeout=30 -o Acquire::Retries=1 -o DPkg::Lock::Timeout=120 "$@" </dev/null
}

install_with_apt() {
    apt_get update || return 1
    for package in libllvm19 libllvm22 libllvm20 libllvm21 libllvm18 libllvm17t64 libllvm17; do
        if apt-cache show "$package" >/dev/null 2>&1; then
            apt_get install --no-install-recommends "$package"
            return
        fi
    done
    return 1
}

may_install() {
    command -v brew || [ "$(id -u)" -eq 0 ] || sudo -n true
}

install_llvm() {
    if command -v brew; then
        brew install --quiet llvm
    elif command -v apt-get; then
        install_with_apt
    elif command -v dnf; then
        as_root dnf install -y -q llvm-libs
    else
        return 1
    fi
}

[ -z "${DESIGNLAB_VARIANT:-}" ] || exit 0
has_usable_back_end && exit 0
if may_install >/dev/null 2>&1; then
    echo "installing LLVM for the renderer ..."
    install_llvm >/dev/null 2>&1 && has_usable_back_end && exit 0
fi
echo "no LLVM 17 or newer: going on with scalar_rgb, slower (designlab doctor says how to get one)"
