# The lab's start, done once: a snapshot of a machine in which the appliance's kernel has just started, from which machines
# go on. A kernel takes seconds to start where each instruction is emulated, and does the same each time.
# Sourced by nested.sh, whose variables it uses.
#
# In the snapshot, takt-carry is the first process and has stopped the machine (vmm/carry/src/start). One that goes on has a PCI
# function more, which is memory with the files of the run. So what differs from run to run is not in the snapshot.
# shellcheck shell=bash
# shellcheck disable=SC2034,SC2154

# Where that function is.
files_slot=0x1d

# use_snapshot: for a machine of QEMU with $options and $icount: sets $snapshot to the file to go on from, and adds the
# memory to $options. If this QEMU makes none, both stay as they are, and the machine starts from nothing.
use_snapshot() {
    local folder=$appliance/snapshots bytes lock before=("${options[@]}")
    bytes=$((memory + overhead + 2 * $(stat -c %s "$appliance/initrd.img") + $(du -sb "$work/files" | cut -f 1)))
    # Few sizes, so that few snapshots serve all.
    options+=(-m "$(doubled $((512 << 20)) "$bytes")B" -device pvpanic -action "panic=pause")
    mkdir -p "$folder"
    exec {lock}>"$folder.lock"
    flock "$lock"
    snapshot=$folder/$(snapshot_name)
    if [[ ! -e $snapshot ]] && ! make_snapshot; then
        # Behind the words of the first process there are those of the kernel, at length.
        grep -a '^takt-carry: ' "$work/snapshot.log" >&2 || tail -n 3 "$work/snapshot.log" >&2
        echo "${0##*/}: this QEMU keeps no snapshot of the appliance; its kernel starts each time" >&2
        snapshot=
        options=("${before[@]}")
    fi
    exec {lock}>&-
}

# snapshot_name: another one for each machine, kernel and initramfs. scripts/appliance removes old ones.
snapshot_name() {
    {
        "${qemu[@]}" --version
        stat --format '%n %i %s %Y' "$appliance/vmlinux" "$appliance/initrd.img"
        printf '%s\n' "$healer" "$icount" "${options[@]}" "$kernel_words"
    } | checksum - | head -c 16
}

# make_snapshot: starts the machine and saves it when it stops itself. There is a $snapshot only if it is whole: QEMU says that all
# is written, and so does what writes it, which does not know an end from a QEMU that was killed.
make_snapshot() {
    local process saved=
    echo "${0##*/}: starting the appliance's kernel; later runs go on from there" >&2
    open_monitor
    rm -f "$snapshot".{new,whole}
    # Not recorded, as QEMU saves nothing then. Nothing is asked of it before it stops, and it stops at the same
    # instruction each time.
    emulate 300 env "TAKT_SNAPSHOT=$snapshot" ${healer:+"LD_PRELOAD=$healer"} \
        "${qemu[@]}" "${options[@]}" -icount "$icount" \
        -kernel "$appliance/vmlinux" -initrd "$appliance/initrd.img" \
        -append "$kernel_words rdinit=/carry -- start 0000:00:${files_slot#0x}.0" \
        -chardev "stdio,id=console,signal=off" -serial chardev:console \
        -chardev "null,id=results" -device "isa-debugcon,iobase=0x402,chardev=results" \
        "${monitor_options[@]}" </dev/null >"$work/snapshot.log" 2>&1 &
    process=$!
    # shellcheck disable=SC2016
    if expect "$process" '"event": "STOP"' &&
        say migrate '{"uri": "exec:cat >\"$TAKT_SNAPSHOT.new\" && : >\"$TAKT_SNAPSHOT.whole\""}' &&
        expect "$process" '"status": "completed"' query-migrate; then
        saved=yes
        # It waits for what it has started.
        say quit
    else
        kill "$process" 2>/dev/null || true
    fi
    wait "$process" || true
    close_monitor
    if [[ -n $saved && -e $snapshot.whole ]]; then
        sync "$snapshot.new" && mv "$snapshot.new" "$snapshot"
    fi
    rm -f "$snapshot".{new,whole}
    [[ -e $snapshot ]]
}

# snapshot_options: what a machine that goes on has beside.
snapshot_options() {
    local size
    printf '%s\0' "${words[@]}" >"$work/files/words"
    pack "$work/files" >"$work/memory"
    rm -rf "$work/files"
    size=$(doubled $((1 << 20)) "$(stat -c %s "$work/memory")")
    truncate --size="$size" "$work/memory"
    open_monitor
    # shellcheck disable=SC2016
    options+=(-incoming 'exec:cat "$TAKT_SNAPSHOT"'
        -object "memory-backend-file,id=files,share=on,size=$size,mem-path=${work//,/,,}/memory"
        -device "ivshmem-plain,memdev=files,addr=$files_slot" "${monitor_options[@]}")
}

# doubled SIZE BYTES: prints SIZE, doubled as often as BYTES need.
doubled() {
    local size=$1
    while ((size < $2)); do size=$((2 * size)); done
    echo "$size"
}

# go_on PROCESS: lets the machine go on that is loaded as PROCESS.
go_on() {
    if expect "$1" guest-panicked query-status; then
        say cont
    else
        echo "${0##*/}: the machine did not go on from $snapshot; remove that if it happens again" >&2
        kill "$1" 2>/dev/null || true
    fi
    close_monitor
}

# open_monitor: makes the way to QEMU's monitor, and sets $monitor_options.
open_monitor() {
    mkfifo "$work/monitor.in" "$work/monitor.out"
    exec {monitor_in}<>"$work/monitor.in" {monitor_out}<>"$work/monitor.out"
    monitor_options=(-chardev "pipe,id=monitor,path=${work//,/,,}/monitor" -mon "chardev=monitor,mode=control")
    say qmp_capabilities
}

close_monitor() {
    exec {monitor_in}>&- {monitor_out}>&-
    rm -f "$work/monitor.in" "$work/monitor.out"
}

# say COMMAND [ARGUMENTS]: tells the monitor.
say() {
    echo "{\"execute\": \"$1\"${2:+, \"arguments\": $2}}" >&"$monitor_in"
}

# expect PROCESS WORDS [COMMAND]: waits until the monitor of PROCESS says a line with WORDS, and asks for it by COMMAND until
# then, fewer times than the way to the monitor has room for. Fails if the process ends, says that something went wrong, or has
# nothing to say for minutes.
expect() {
    local asked line begun=
    for ((asked = 0; asked < 2000; asked++)); do
        kill -0 "$1" 2>/dev/null || return 1
        [[ -z ${3-} ]] || say "$3"
        while read -r -t 0.1 line <&"$monitor_out"; do
            line=$begun$line begun=
            case $line in
            *"$2"*) return 0 ;;
            *'"error"'* | *'"status": "failed"'*) return 1 ;;
            esac
        done
        # Of a line that has not come whole yet.
        begun+=$line
    done
    return 1
}
