# Debian packages: install what a script needs, and fetch others without installing them.
# Sourced; expects $root, the top of the project. Nothing here touches the network when
# everything is there already.
#
# What the emulated machines are made of comes from a suite of Debian's archive: the one that this machine has
# in its sources, or the one that $TAKT_SUITE names, which has a folder of its own below target/.
# shellcheck shell=bash

# Users other than root have no folder of system programs, such as mke2fs and depmod, in their PATH.
export PATH=$PATH:/usr/local/sbin:/usr/sbin:/sbin
# What apt and others print is read.
export LC_ALL=C.UTF-8
# Debian 12's libc lets it win over that.
unset LANGUAGE

keep_packages=

fail() {
    echo "${0##*/}: $*" >&2
    exit 1
}

# A library that is preloaded (heal_qemu) cannot have such a path.
[[ $root != *[[:space:]:]* ]] || fail "the path $root has a blank or a colon; move the project to one without"

# use_suite SUITE: from here on, kernels, compiler, busybox and QEMU are those of this suite of Debian (a code
# name, such as trixie), by its archive and without installing anything. Empty: those of this machine.
# Sets $suite, the folder $built for all that is made of them, $cache, and $apt, the options with which
# apt's programs look at that suite as a bare machine would: what is installed here may be newer than what the
# lists name, and could then not be downloaded.
use_suite() {
    [[ $1 =~ ^[a-z]*$ ]] || fail "\"$1\" is no suite of Debian; those have code names, such as trixie"
    suite=$1
    export TAKT_SUITE=$suite
    built=$root/target${suite:+/$suite}
    cache=$built/cache
    if [[ -z $suite ]]; then
        lists=
        apt=("${bare[@]}")
    else
        look_at "$suite" deb
    fi
}

bare=(-o Dir::State::status=/dev/null -o Debug::NoLocking=1
    # What has been downloaded before is not among what apt says it would download.
    -o Dir::Cache::archives=/nonexistent
    # apt would rather download as a user of its own, who cannot write here, and says so.
    -o APT::Sandbox::User=root)

# look_at SUITE TYPE: sets $apt as use_suite does, to look only at the packages (TYPE deb) or
# their sources (deb-src) of this suite, by $lists of their own.
look_at() {
    lists=$root/target/lists/$1-$2
    apt=("${bare[@]}" -o "Dir::Etc::SourceList=$lists/sources.list" -o Dir::Etc::SourceParts=/dev/null
        -o Dir::Etc::Preferences=/dev/null -o Dir::Etc::PreferencesParts=/dev/null
        -o APT::Default-Release= -o "Dir::State::Lists=$lists/lists" -o "Dir::Cache=$lists/cache"
        -o Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false)
}

# lists_are_old: whether those that $apt reads are missing or a day old. Those of the machine are its own
# matter.
lists_are_old() {
    [[ -n $lists && -z $(find "$lists/fetched" -mtime -1 2>/dev/null) ]]
}

# bring_lists: brings those that $apt reads up to date.
bring_lists() {
    if [[ -z $lists ]]; then
        update_own_lists
        return
    fi
    echo "${0##*/}: fetching apt's lists for ${lists##*/}" >&2
    need_packages debian-archive-keyring
    mkdir -p "$lists"/{lists/partial,cache}
    (
        flock 9
        name_sources "${lists##*/}" >"$lists/sources.list"
        apt-get "${apt[@]}" -qq -o APT::Update::Error-Mode=any update >&2 && touch "$lists/fetched"
    ) 9>"$lists/lock" || {
        echo "${0##*/}: the lists could not be fetched from $(cut -d ' ' -f 4,5 "$lists/sources.list" | xargs)" >&2
        return 1
    }
}

# name_sources SUITE-TYPE: prints the sources for look_at: at the addresses of this machine's own, or at the
# usual ones if this is not Debian.
name_sources() {
    local suite=${1%%-*} type=${1#*-} keyring=/usr/share/keyrings/debian-archive-keyring.gpg
    local archive=http://deb.debian.org/debian security=http://deb.debian.org/debian-security
    if [[ $(os_release ID) == debian ]]; then
        archive=$(own_archive) || {
            update_own_lists
            archive=$(own_archive) || fail "apt does not say where this machine's packages come from"
        }
        # shellcheck disable=SC2016
        security=$(apt-get indextargets --format '$(RELEASE) $(SITE)' 'Created-By: Packages' |
            awk '$1 ~ /-security$/ && !seen++ { print $2 }')
    fi
    echo "$type [arch=amd64 signed-by=$keyring] $archive $suite main"
    [[ -z $security ]] || echo "$type [arch=amd64 signed-by=$keyring] $security $suite-security main"
}

# own_archive: prints the address of the archive that this machine's basic packages come from.
own_archive() {
    apt-get "${bare[@]}" --print-uris download base-files 2>/dev/null |
        sed -n "s/^'\\(.*\\)\\/pool\\/.*/\\1/p" | grep .
}

# os_release NAME: prints what /etc/os-release says.
os_release() {
    # shellcheck source=/dev/null
    (source /etc/os-release && echo "${!1-}")
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

update_own_lists() {
    local said tries
    echo "${0##*/}: bringing apt's package lists up to date" >&2
    # For the lock of its lists apt does not wait.
    for ((tries = 0; ; tries++)); do
        said=$(as_root apt-get update -qq -o DPkg::Lock::Timeout=600 2>&1) && return
        if ((tries == 120)) || [[ $said != *lists/lock* ]]; then
            echo "$said" >&2
            return 1
        fi
        sleep 5
    done
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
        update_own_lists
        install_packages "${missing[@]}"
    } || fail "apt-get could not install ${missing[*]}"
}

install_packages() {
    as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get install -qq --no-install-recommends -o DPkg::Lock::Timeout=600 "$@" </dev/null >&2
}

# newest LINK NAME FETCH [ARGUMENT]...: prints the folder behind $cache/LINK, made of what apt knows now. NAME
# ARGUMENT... prints what that folder is called, or nothing if apt does not know; FETCH FOLDER makes it.
# Without a network, or without package lists, the last one serves; with $keep_packages set in any case.
newest() {
    local last=$cache/$1 name=$2 fetch=$3 arguments=("${@:4}") brought=
    mkdir -p "$cache"
    if [[ -n $keep_packages && -e $last ]]; then
        readlink -f "$last"
        return
    fi
    if lists_are_old; then
        brought=yes
        bring_lists || true
    fi
    if link_newest; then
        :
    elif [[ -e $last ]]; then
        echo "${0##*/}: keeping what ${last##*/} was before" >&2
    else
        # There are no lists yet, or they are older than what the archive still holds.
        [[ -n $brought ]] || bring_lists
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
    newest "linux-image-$1" current_kernel download_package "$1"
}

# current_kernel FLAVOUR: prints PACKAGE_VERSION of the kernel behind linux-image-FLAVOUR. The
# metapackage may lead to a plain or an -unsigned package.
current_kernel() {
    local package
    package=$(apt-cache "${apt[@]}" depends "linux-image-$1" 2>/dev/null |
        awk '/Depends: linux-image-[0-9]/ && !seen++ { print $NF }')
    [[ -z $package ]] || current_version "$package"
}

# current_version PACKAGE: prints PACKAGE_VERSION; nothing if apt does not know it.
current_version() {
    apt-cache "${apt[@]}" show --no-all-versions "$1" 2>/dev/null |
        awk -v package="$1" '/^Version:/ && !seen++ { print package "_" $2 }'
}

# download_package FOLDER: the package that the folder is called after, unpacked.
download_package() {
    local package=${1##*/}
    unpack_packages "$1" "${package%%_*}"
}

# one_of FILE...: prints the one that exists. Older suites keep below / what newer ones keep below /usr.
one_of() {
    local file
    for file in "$@"; do
        [[ ! -e $file ]] || echo "$file"
    done | grep --max-count=1 . || fail "there is none of $*"
}

# with_dependencies PACKAGE...: prints the package files of these and of all that they depend on, as apt would
# install them on a bare machine; nothing if it does not know one of them.
with_dependencies() {
    apt-get "${apt[@]}" install -qq --no-install-recommends --print-uris "$@" 2>/dev/null |
        awk '{ print $2 }'
}

# unpack_packages FOLDER PACKAGE...: makes the folder, of what is in these packages.
unpack_packages() {
    local work file status=0
    work=$(mktemp -d "$cache/download.XXXXXX")
    echo "${0##*/}: downloading $2$( (($# == 2)) || echo " and $(($# - 2)) packages more")" >&2
    (cd "$work" && apt-get "${apt[@]}" -qq download "${@:2}") >&2 || status=1
    for file in "$work"/*.deb; do
        ((status)) || dpkg -x "$file" "$work/unpacked" || status=1
    done
    ((status)) || mv -T "$work/unpacked" "$1" || status=1
    rm -rf "$work"
    return "$status"
}

# download_source FOLDER PACKAGE [SUITE]: puts upstream's archive of a source package, without Debian's changes,
# into the folder, checked by apt as any other, from the suite that is in use if none is named. Most machines
# have no list of sources, so one of its own is read.
download_source() {
    local apt lists suite=${3:-${suite:-$(os_release VERSION_CODENAME)}}
    look_at "$suite" deb-src
    echo "${0##*/}: downloading the source of $2" >&2
    ! lists_are_old || bring_lists || return 1
    mkdir -p "$1"
    (cd "$1" && apt-get "${apt[@]}" -qq source --download-only --tar-only "$2") >&2
}

# need_cargo: Rust's build tool, and a linker for it.
need_cargo() {
    command -v cargo >/dev/null || fail "cargo is missing: install Rust from https://rustup.rs"
    command -v cc >/dev/null || need_packages gcc libc6-dev
}

use_suite "${TAKT_SUITE-}"
