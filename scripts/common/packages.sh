# Debian packages: install what a script needs, and fetch kernels without installing them.
# Sourced; expects $root, the top of the project. Nothing here touches the network when
# everything is there already.
# shellcheck shell=bash

cache=$root/target/cache
keep_packages=

fail() {
    echo "${0##*/}: $*" >&2
    exit 1
}

# help_or_usage WORD: shows the comment that the script opens with, and ends the script: well if
# WORD asked for it, as a mistake if it did not.
help_or_usage() {
    local status=2
    case $1 in --help | -h) status=0 ;; esac
    sed -n "2,/^[^#]/s/^# \\{0,1\\}//p" "$0" >&$((status ? 2 : 1))
    exit "$status"
}

as_root() {
    if ((EUID == 0)); then "$@"; else sudo "$@"; fi
}

update_package_lists() {
    echo "${0##*/}: bringing apt's package lists up to date" >&2
    as_root apt-get update -qq >&2
}

# need_packages PACKAGE...: installs those that are missing.
need_packages() {
    local package missing=()
    for package in "$@"; do
        [[ $(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null) == installed ]] ||
            missing+=("$package")
    done
    ((${#missing[@]})) || return 0
    echo "${0##*/}: installing ${missing[*]}" >&2
    install_packages "${missing[@]}" || {
        update_package_lists
        install_packages "${missing[@]}"
    } || fail "apt-get could not install ${missing[*]}"
}

install_packages() {
    as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get install -qq --no-install-recommends "$@" </dev/null >&2
}

# newest LINK NAME FETCH [ARGUMENT]...: prints the folder behind $cache/LINK, made of what apt knows now. NAME
# ARGUMENT... prints what that folder is called, or nothing if apt does not know; FETCH FOLDER makes it.
# Without a network, or without package lists, the last one serves; with $keep_packages set in any case.
newest() {
    local last=$cache/$1 name=$2 fetch=$3 arguments=("${@:4}")
    mkdir -p "$cache"
    if [[ -n $keep_packages && -e $last ]] || link_newest; then
        :
    elif [[ -e $last ]]; then
        echo "${0##*/}: keeping what ${last##*/} was before" >&2
    else
        # There are no lists yet, or they are older than what the archive still holds.
        update_package_lists
        link_newest || fail "apt does not find or cannot download ${last##*/} (Debian is needed)"
    fi
    readlink -f "$last"
}

# link_newest: what newest tries, with its variables.
link_newest() {
    local folder
    folder=$("$name" "${arguments[@]}")
    [[ -n $folder ]] || return 1
    [[ -d $cache/$folder ]] || "$fetch" "$cache/$folder" || return 1
    ln -sfn "$folder" "$last"
}

# fetch_kernel FLAVOUR: prints the folder that the flavour's current kernel package is unpacked in.
fetch_kernel() {
    newest "linux-image-$1" current_kernel download_kernel "$1"
}

# current_kernel FLAVOUR: prints PACKAGE_VERSION of the kernel behind linux-image-FLAVOUR. The
# metapackage may lead to a plain or an -unsigned package.
current_kernel() {
    local package
    package=$(apt-cache depends "linux-image-$1" 2>/dev/null |
        awk '/Depends: linux-image-[0-9]/ && !seen++ { print $NF }')
    [[ -n $package ]] || return 0
    apt-cache show --no-all-versions "$package" 2>/dev/null |
        awk -v package="$package" '/^Version:/ && !seen++ { print package "_" $2 }'
}

# download_kernel FOLDER: the package that the folder is called after, unpacked.
download_kernel() {
    local package=${1##*/} work status=0
    package=${package%%_*}
    work=$(mktemp -d "$cache/download.XXXXXX")
    echo "${0##*/}: downloading $package" >&2
    # apt would rather download as a user of its own, who cannot write here, and says so.
    (cd "$work" && apt-get -qq -o APT::Sandbox::User=root download "$package") >&2 &&
        dpkg -x "$work/$package"_*.deb "$work/unpacked" &&
        mv -T "$work/unpacked" "$1" || status=1
    rm -rf "$work"
    return "$status"
}

# need_cargo: Rust's build tool, and a linker for it.
need_cargo() {
    command -v cargo >/dev/null || fail "cargo is missing: install Rust from https://rustup.rs"
    command -v cc >/dev/null || need_packages gcc libc6-dev
}
