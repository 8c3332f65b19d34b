# QEMU's emulation, healed of two faults, and what a report says of it.
# Sourced; expects packages.sh.
# shellcheck shell=bash

# heal_qemu: for a machine that QEMU emulates. Sets $healer to the library to preload into QEMU
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
    version=$(qemu-system-x86_64 --version | sed -n 's/^QEMU emulator version \([^ ]*\).*/\1/p')
    heals=$(TAKT_HEAL_TELL=1 LD_PRELOAD=$healer qemu-system-x86_64 --version | head -n 1)
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
