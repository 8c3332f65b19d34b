# Carries Takt's control socket out of the emulated machine, to the path on this machine that the partition file names.
# Sourced by scripts/run. The caller sets:
#   carry    the program takt-carry
#   control  the path of the control socket, or empty
#   file     the partition file
#   lane     where it runs
#   work     an empty folder for temporary files
# shellcheck shell=bash
# shellcheck disable=SC2154

# The slot of the function that is the line; nothing else is there in QEMU's q35, and in Bochs it is always this one.
control_slot=0x1e
control_line=

# open_control: makes the line, and listens to the socket from the moment at which Takt answers.
open_control() {
    [[ -n $control ]] || return 0
    control_line=$work/line
    "$carry" make "$control_line" "$control" || exit 2
    # It ends when this script does, in whatever way.
    exec {carrier}> >(
        trap '' INT
        exec "$carry" outside "$control_line" "$control"
    )
    carrier_process=$!
    echo "run: control socket $control, as soon as Takt runs: takt ctl $file status" >&2
}

# control_words: adds the words that tell process 1 of the line.
control_words() {
    [[ -z ${control_line-} ]] ||
        words+=("TAKT_CONTROL_LINE=0000:00:${control_slot#0x}.0" "TAKT_CONTROL_SOCKET=$control")
}

# control_options: adds the line to QEMU's machine.
control_options() {
    [[ -n ${control_line-} ]] || return 0
    local size
    size=$(stat -c %s "$control_line")
    options+=(-object "memory-backend-file,id=control,share=on,size=$size,mem-path=${control_line//,/,,}"
        -device "ivshmem-plain,memdev=control,addr=$control_slot")
}

# close_control: the socket goes.
close_control() {
    [[ -n $control_line ]] || return 0
    exec {carrier}>&-
    wait "$carrier_process" || true
}
