# Debian packages: install what a script needs, and fetch kernels without installing them.
# Sourced; expects $root, the top of the project. Nothing here touches the network when
# everything is there already.
# shellcheck shell=bash

cache=$root/target/cache
keep_kernel=

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

# current_kernel FLAVOUR: prints "PACKAGE VERSION" of the kernel behind linux-image-FLAVOUR as
# apt knows it now, or nothing. The metapackage may lead to a plain or an -unsigned package.
current_kernel() {
    local package
    package=$(apt-cache depends "linux-image-$1" 2>/dev/null |
        awk '/Depends: linux-image-[0-9]/ && !seen++ { print $NF }')
    [[ -n $package ]] || return 0
    apt-cache show --no-all-versions "$package" 2>/dev/null |
        awk -v package="$package" '/^Version:/ && !seen++ { print package, $2 }'
}

# fetch_kernel FLAVOUR: prints the folder that the flavour's current kernel package is unpacked
# in, downloading it if needed. Without a network, or without package lists, the last one serves.
# With $keep_kernel set, the last one serves in any case.
fetch_kernel() {
    local flavour=$1 current folder last=$cache/linux-image-$1
    mkdir -p "$cache"
    if [[ -n $keep_kernel && -e $last ]]; then
        readlink -f "$last"
        return
    fi
    current=$(current_kernel "$flavour")
    if [[ -z $current && ! -e $last ]]; then
        update_package_lists
        current=$(current_kernel "$flavour")
        [[ -n $current ]] || fail "apt knows no linux-image-$flavour (Debian is needed)"
    fi
    folder=${current// /_}
    if [[ -n $current && ! -d $cache/$folder ]]; then
        if download_kernel "$flavour" "$cache/$folder"; then
            :
        elif [[ -e $last ]]; then
            echo "${0##*/}: keeping the kernel that is there" >&2
            folder=
        else
            # The lists may be older than what the archive still holds.
            update_package_lists
            current=$(current_kernel "$flavour")
            folder=${current// /_}
            download_kernel "$flavour" "$cache/$folder" ||
                fail "cannot download the kernel package ${current% *}"
        fi
    fi
    [[ -z $folder ]] || ln -sfn "$folder" "$last"
    readlink -f "$last"
}

# download_kernel FLAVOUR FOLDER: the package that apt names now, unpacked into FOLDER.
download_kernel() {
    local package work status=0
    package=$(current_kernel "$1")
    package=${package% *}
    work=$(mktemp -d "$cache/download.XXXXXX")
    echo "${0##*/}: downloading $package" >&2
    # apt would rather download as a user of its own, who cannot write here, and says so.
    (cd "$work" && apt-get -qq -o APT::Sandbox::User=root download "$package") >&2 &&
        dpkg -x "$work/$package"_*.deb "$work/unpacked" &&
        mv -T "$work/unpacked" "$2" || status=1
    rm -rf "$work"
    return "$status"
}

# need_cargo: Rust's build tool, and a linker for it.
need_cargo() {
    command -v cargo >/dev/null || fail "cargo is missing: install Rust from https://rustup.rs"
    command -v cc >/dev/null || need_packages gcc libc6-dev
}
