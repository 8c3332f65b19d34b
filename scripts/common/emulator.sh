# The emulators: the commands that start them, healed of faults, and what a report says of them.
# Sourced; expects packages.sh and images.sh.
# shellcheck shell=bash
# shellcheck source=scripts/common/bochs.sh
source "$root/scripts/common/bochs.sh"

# choose_emulator: gets ready what runs the machine for $lane. Sets $emulator to what the report says of
# it, and what heal_qemu sets; all are empty where nothing is emulated. Where it is QEMU it sets $qemu.
choose_emulator() {
    emulator=
    healer=
    heals=
    case $lane in
    nested) qemu_command ;;
    vmx | svm) build_bochs ;;
    *)
        qemu_command
        heal_qemu
        ;;
    esac
}

# qemu_command: sets $qemu, the command that starts QEMU, as an array: this machine's, or the suite's with its
# own libraries, which its own dynamic loader finds, and its own firmware.
qemu_command() {
    local folder loader
    if [[ -z $suite ]]; then
        need_packages qemu-system-x86
        qemu=(qemu-system-x86_64)
        return
    fi
    folder=$(one_build_at_a_time && newest qemu current_qemu download_qemu) || exit
    loader=$(one_of "$folder"/{lib,usr/lib}/x86_64-linux-gnu/ld-linux-x86-64.so.2)
    # QEMU's own parts are found by its build's path otherwise.
    export QEMU_MODULE_DIR=$folder/usr/lib/x86_64-linux-gnu/qemu
    qemu=("$loader" --inhibit-cache
        --library-path "$folder/lib/x86_64-linux-gnu:$folder/usr/lib/x86_64-linux-gnu"
        "$folder/usr/bin/qemu-system-x86_64"
        -L "$folder/usr/share/qemu" -L "$folder/usr/share/seabios")
}

# qemu_release: prints the first number of the version of $qemu.
qemu_release() {
    "${qemu[@]}" --version | sed -n 's/^QEMU emulator version \([0-9]*\).*/\1/p'
}

# current_qemu: prints what the folder with QEMU and all that it depends on is called; nothing if apt knows none.
current_qemu() {
    local packages
    packages=$(with_dependencies qemu-system-x86)
    [[ -z $packages ]] || echo "qemu-$(sha256sum <<<"$packages" | head -c 16)"
}

# download_qemu FOLDER: makes it.
download_qemu() {
    local names
    mapfile -t names < <(with_dependencies qemu-system-x86 | cut -d _ -f 1)
    unpack_packages "$1" "${names[@]}"
}

# heal_qemu: for a machine that $qemu emulates. Sets $healer to the library to preload into QEMU
# (scripts/qemu/heal.c), $emulator to what the report says of QEMU, and $heals to the two words by which the
# library tells what it does for this QEMU. Says the same in one line.
heal_qemu() {
    local source=$root/scripts/qemu/heal.c new version
    healer=$cache/heal-$(checksum "$source" | head -c 16).so
    if [[ ! -e $healer ]]; then
        command -v cc >/dev/null || need_packages gcc libc6-dev
        mkdir -p "$cache"
        new=$(mktemp "$cache/heal.XXXXXX")
        cc -O2 -Wall -Wextra -Werror -shared -fPIC -o "$new" "$source"
        mv "$new" "$healer"
    fi
    version=$("${qemu[@]}" --version | sed -n 's/^QEMU emulator version \([^ ]*\).*/\1/p')
    heals=$(TAKT_HEAL_TELL=1 LD_PRELOAD=$healer "${qemu[@]}" --version | head -n 1)
    case $heals in
    "once kept") emulator="QEMU $version, healed: each interrupt is delivered once and none is lost" ;;
    "once lost") emulator="QEMU $version, half healed: on two CPUs an interrupt can be lost" ;;
    *)
        heals="twice lost"
        emulator="QEMU $version, not healed, since its code is not known: an interrupt can be delivered twice or lost"
        ;;
    esac
    echo "${0##*/}: $emulator" >&2
}
