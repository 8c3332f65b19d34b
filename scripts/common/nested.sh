# Runs the appliance in an emulated machine, with a partition file and all that it names.
# Sourced; expects packages.sh, images.sh and emulator.sh, and sources snapshot.sh. The caller sets:
#   appliance  the folder of the appliance to run: see appliance_folder
#   lane       nested, lab or emulated, which are QEMU's; vmx or svm, which are those of Bochs
#   files      the partition file and the images it names, as absolute paths
#   folders    folders that it writes into, as an array, or unset
#   memory     bytes that the guests need together
#   cpus       CPUs that the partition file uses
#   command    what takt is to do there, as an array; it may write into /out
#   qemu       the command that starts QEMU, as an array: see qemu_command
#   healer     what to preload into QEMU, or nothing: see heal_qemu
#   work       an empty folder for temporary files
#   clock      "steered" if somebody there is to steer the kernel's clock, or unset
#   overlay    a folder to lie over the appliance's root, or empty
#   control    the control socket to carry out, or empty; with control.sh
#   TAKT_MACHINE_TIMES  see note_time; in the environment, or unset
#   devices    what else the machine is to have, as an array: see device_options
# shellcheck shell=bash
# shellcheck source=scripts/common/snapshot.sh
source "$root/scripts/common/snapshot.sh"

# What the appliance needs beside its guests and its files: the kernel, its tables and takt.
overhead=$((160 << 20))

# run_appliance: runs it to its end, with the console on standard input and output, and leaves
# in $status the exit status that takt had there.
run_appliance() {
    local words=() kernel_words machine output errors process outcome=0 snapshot=
    gather_files
    # loglevel=3 leaves the console to takt unless the kernel is dying. The kernel's tests of its
    # own cryptography would take longer than all the rest of its start, and two more of its parts
    # that are not needed here a tenth of it. In a ramfs, files are what they are in the page cache of a
    # disk; tmpfs takes twice as long for each page, for it keeps in mind which to swap out.
    kernel_words="console=ttyS0 loglevel=3 panic=-1 nokaslr cryptomgr.notests"
    kernel_words+=" rootfstype=ramfs initcall_blacklist=init_kprobe_trace,cubictcp_register"
    # Nothing here reads how long tasks wait for what (PSI), of which the kernel takes note at each change of
    # threads; and the security modules that no policy is loaded for are asked at each KVM_RUN.
    kernel_words+=" psi=0 lsm=landlock,lockdown,yama"
    # What the lab's clock is needs no measuring, which would be off by some millionths.
    case $lane in lab | vmx | svm) kernel_words+=" tsc_early_khz=1000000" ;; esac
    # Process 1 finds these in its environment.
    [[ ${clock-} != steered ]] || words+=(TAKT_STEERED=1)
    [[ -z ${control-} ]] || control_words
    words+=(-- "${command[@]}")

    remember_terminal
    claim_cpus
    case $lane in
    vmx | svm) bochs_machine ;;
    *) qemu_machine ;;
    esac

    # In the background, with this script waiting, a signal to the script ends the machine at once;
    # and if the script is killed, the kernel ends the machine.
    emulate "${TAKT_TIMEOUT:-0}" "${machine[@]}" <&0 >&"$output" 2>&"$errors" &
    process=$!
    trap 'kill "$process" 2>/dev/null; exit 1' INT TERM HUP
    [[ -z $snapshot ]] || go_on "$process"
    wait "$process" || outcome=$?
    trap - INT TERM HUP
    exec {output}>&- {errors}>&-
    [[ -z ${console-} ]] || close_console
    [[ -z ${TAKT_MACHINE_TIMES-} ]] || note_time
    restore_terminal
    read_status "$outcome"
}

# emulate SECONDS COMMAND...: becomes an emulator, on $cpu_list, for at most that much real time.
# Whatever competes with the lab slows it down. Only root may ask for more than its share.
emulate() {
    exec setpriv --pdeathsig TERM \
        nice -n -15 \
        taskset --cpu-list "$cpu_list" \
        timeout --foreground "$1" \
        setpriv --pdeathsig KILL \
        "${@:2}"
}

# note_time: appends to the file $TAKT_MACHINE_TIMES how many seconds of a processor the machine took, and what ran in it.
note_time() {
    local minutes seconds
    # In this shell: in another one there would be no children.
    times >"$work/times"
    IFS=ms read -r minutes seconds < <(tail -n 1 "$work/times")
    echo "$((10#$minutes * 60 + 10#${seconds%%.*})) ${0##*/} ${command[*]}" >>"$TAKT_MACHINE_TIMES"
}

# lay_hooked_takt_over: puts Takt with the hooks of tests into $overlay, in the place of the appliance's.
lay_hooked_takt_over() {
    build_hooked_takt
    mkdir -p "$overlay"
    strip -o "$overlay/init" "${CARGO_TARGET_DIR:-$root/target}/x86_64-unknown-linux-gnu/hooks/takt"
}

# qemu_machine: sets $machine to QEMU with its console on standard input and output, and $output. In the lab it goes on
# from a $snapshot, unless it is to have other devices.
qemu_machine() {
    local options=() icount= device line
    machine_options
    options+=(-nodefaults -no-user-config -display none -no-reboot)
    if [[ $lane == lab ]] && ((${#devices[@]} == 0)); then
        use_snapshot
    fi
    # So that two runs of the same are the same, QEMU records the run, for which its devices have to keep an order
    # that does not depend on its threads. The record is of no use, and what is typed would not arrive.
    [[ -z $icount || ! /dev/stdin -ef /dev/null ]] || icount+=,rr=record,rrfile=/dev/null
    # Without signal=off, Ctrl-C would end QEMU instead of reaching takt.
    options+=(${icount:+-icount "$icount"}
        -chardev "stdio,id=console,signal=off,logfile=$work/console.log" -serial chardev:console
        # Where takt leaves its results; its other end is vmm/src/appliance/result_port.rs.
        -chardev "file,id=results,path=$work/results"
        -device "isa-debugcon,iobase=0x402,chardev=results")
    for device in "${devices[@]}"; do
        device_options "$device"
    done
    [[ -z ${control-} ]] || control_options
    if [[ -n $snapshot ]]; then
        snapshot_options
    else
        make_initrd
        line=$(command_line)
        options+=(-m "$(machine_memory)M" -kernel "$appliance/vmlinux" -initrd "$work/initrd" -append "$line")
    fi
    machine=(env ${snapshot:+"TAKT_SNAPSHOT=$snapshot"} ${healer:+"LD_PRELOAD=$healer"}
        "${qemu[@]}" "${options[@]}")
    exec {output}>&1 {errors}>&2
}

# claim_cpus: sets $cpu_list to the CPUs for the machine. One that is emulated has them for itself, until this
# script ends: the lab's threads hand over to each other at every event and two labs on the same CPU would be
# many times slower. A machine that counts instructions has one CPU; another one has a CPU for each of its own and
# one for QEMU's other threads, unless it loses interrupts on two (docs/decisions/0012-qemu-takes-its-lock.md).
claim_cpus() {
    local allowed wanted=1 cpu told=
    cpu_list=$(sed -n 's/^Cpus_allowed_list:\t//p' /proc/self/status)
    [[ $lane != nested ]] || return 0
    mapfile -t allowed < <(cpus_of "$cpu_list")
    [[ $lane != emulated || $heals != *kept ]] || wanted=$((cpus + 1))
    ((wanted <= ${#allowed[@]})) || wanted=${#allowed[@]}
    if ((wanted == 1)); then
        while :; do
            for cpu in "${allowed[@]}"; do
                cpu_list=$cpu
                ! claim_cpu "$cpu" --nonblock || return 0
            done
            [[ -n $told ]] || say_waiting
            told=yes
            sleep 1
        done
    fi
    cpu_list=
    # Each in its order and the same ones always, so that two such scripts cannot wait for each other.
    for cpu in "${allowed[@]:0:wanted}"; do
        claim_cpu "$cpu" --nonblock || { say_waiting && claim_cpu "$cpu"; }
        cpu_list+=${cpu_list:+,}$cpu
    done
}

# claim_cpu CPU [--nonblock]: until this script ends.
claim_cpu() {
    local lock file=${TMPDIR:-/tmp}/takt-lab-cpu-$1
    # Made by the first user, for all: the kernel lets none, not even root, open another's file in /tmp to make it.
    (umask 022 && set -o noclobber && : >"$file") 2>/dev/null || true
    exec {lock}<"$file"
    flock "${@:2}" "$lock" || {
        exec {lock}>&-
        return 1
    }
}

say_waiting() {
    echo "${0##*/}: waiting for a CPU that has another emulated machine" >&2
}

# cpus_of LIST: prints each CPU of a list as the kernel writes it, such as 0-3,5.
cpus_of() {
    local range
    for range in ${1//,/ }; do
        seq "${range%-*}" "${range#*-}"
    done
}

# machine_options: sets what differs from lane to lane.
machine_options() {
    # The timer of an x2APIC is read by an instruction that QEMU 10 does not let a machine that counts
    # instructions have in the middle of a block ("Bad icount read").
    # Without constant_tsc, which QEMU's own CPU does not offer, kvm-amd refuses a PREEMPT_RT
    # kernel. Linux takes it for granted on a machine that looks like VMware's.
    # The firmware would wait for disks, which are not there, as long as the kernel takes for a quarter of its start.
    local emulated=(-machine "q35,vmport=on,sata=off" -smbios "type=1,serial=VMware-42"
        -cpu "max,-hypervisor,-erms,-fsrm,-x2apic")
    case $lane in
    nested)
        options=(-accel kvm -machine q35 -cpu host -smp "$cpus")
        ;;
    lab)
        # One guest instruction is one nanosecond, whatever else this machine does. Its day (later than any file) and
        # its random numbers are the same each time.
        icount=shift=0,sleep=off
        options=(-accel "tcg,thread=single"
            -rtc "base=2030-01-01,clock=vm" -seed "${TAKT_LAB_SEED:-1}" "${emulated[@]}" -smp 1)
        ;;
    emulated)
        # A Linux guest that runs beside a PLC on another CPU has died of a triple fault early in its
        # start, most times: with nested paging in QEMU 7.2, whose walk of its page tables finds reserved
        # bits set, and with KVM's shadow page tables in QEMU 10. Each gets what works. The last -cpu counts.
        local cpu=max,-hypervisor,-x2apic
        (($(qemu_release) >= 10)) || cpu+=,npt=off
        options=(-accel "tcg,thread=multi" "${emulated[@]}" -cpu "$cpu" -smp "$cpus")
        ;;
    esac
}

# device_options DEVICE: adds a device for a partition to drive. No driver of the appliance's
# kernel knows any of them.
device_options() {
    local path
    case $1 in
    parallel=?*)
        # In QEMU's options a comma of the path's own is written twice.
        path=${1#*=}
        options+=(-chardev "file,id=parallel,path=${path//,/,,}"
            -device "isa-parallel,chardev=parallel")
        ;;
    can)
        # The second card does not start with one of its two sides left open.
        options+=(-object "can-bus,id=can" -object "can-bus,id=idle"
            -device "kvaser_pci,canbus=can,addr=0x10"
            -device "mioe3680_pci,canbus0=can,canbus1=idle,addr=0x11")
        ;;
    watchdog) options+=(-device "i6300esb,addr=0x7" -action "watchdog=reset") ;;
    edu) options+=(-device "edu,addr=0x6") ;;
    iommu)
        # What looks like an AMD machine has Intel's: the kernel goes by the firmware's tables.
        options+=(-device "intel-iommu,intremap=on")
        kernel_words+=" intel_iommu=on"
        ;;
    shared=?*)
        path=${1#*=}
        options+=(-object "memory-backend-file,id=shared,share=on,size=1M,mem-path=${path//,/,,}"
            -device "ivshmem-plain,memdev=shared,addr=0x8")
        ;;
    *) fail "unknown device $1; see scripts/run --help" ;;
    esac
}

# gather_files: $files at the paths that they have here, so that relative paths in the partition file mean the same,
# and over them $overlay: in $work/files. Links are followed, since their targets are not
# there. A file of target/guest is that of the suite.
gather_files() {
    local file guest=$root/target/guest
    mkdir "$work/files"
    ((${#files[@]} == 0)) || cp --recursive --dereference --parents "${files[@]}" "$work/files"
    if [[ -n $suite ]]; then
        for file in "${files[@]}"; do
            [[ $file != "$guest"/* ]] || cp "$built/guest/${file#"$guest"/}" "$work/files$file"
        done
    fi
    # Where it writes retained values.
    [[ -z ${folders[*]-} ]] || mkdir -p "${folders[@]/#/"$work/files"}"
    # Where Takt makes its control socket.
    [[ -z ${control-} ]] || mkdir -p "$work/files${control%/*}"
    [[ -z ${overlay-} ]] || cp --recursive --no-dereference --preserve=mode "$overlay/." "$work/files"
}

# make_initrd: the appliance's initramfs with the files behind it.
make_initrd() {
    {
        cat "$appliance/initrd.img"
        pack "$work/files"
    } >"$work/initrd"
    rm -rf "$work/files"
}

# command_line: prints the kernel's command line. The kernel hands its first process the words that it does not know.
command_line() {
    local word line=$kernel_words
    for word in "${words[@]}"; do
        word=$(kernel_word "$word") || exit
        line+=" $word"
    done
    echo "$line"
}

# kernel_word WORD: WORD as the kernel's command line must have it to reach takt whole.
kernel_word() {
    case $1 in
    *\"*) fail "a quotation mark cannot be passed to the appliance: $1" ;;
    *[[:space:]]*) echo "\"$1\"" ;;
    *) echo "$1" ;;
    esac
}

# machine_memory: prints the machine's memory in MiB. The initramfs counts twice, as the archive
# and as the files unpacked from it.
machine_memory() {
    local bytes
    bytes=$((memory + overhead + 2 * $(stat -c %s "$work/initrd")))
    echo $(((bytes >> 20) / 64 * 64 + 64))
}

remember_terminal() {
    terminal=
    if [[ -t 0 ]]; then
        terminal=$(stty -g)
    fi
}

restore_terminal() {
    # One that has been closed takes nothing, and what follows has to be done all the same.
    [[ -z ${terminal-} ]] || stty "$terminal" 2>/dev/null || true
}

# read_status OUTCOME: sets $status from the result archive. Its last file is the status, so
# an archive without one is a run that broke off.
read_status() {
    local log
    status=$(result status 2>/dev/null) || status=
    if [[ $status =~ ^[0-9]+$ ]]; then
        # What the emulator makes of a machine that has switched itself off is its own matter. 124 is the time-out, and
        # from 125 on something has broken.
        if (($1 >= 124)); then
            echo "${0##*/}: takt ended with $status, and its machine did not switch itself off (status $1)" >&2
            status=3
        fi
        return 0
    fi
    status=3
    mkdir -p "$built/failed"
    log=$(mktemp "$built/failed/console.XXXXXX")
    cp "$work/console.log" "$log" 2>/dev/null || true
    if (($1 == 124)); then
        echo "${0##*/}: no result within $TAKT_TIMEOUT s; the console is in $log" >&2
    else
        echo "${0##*/}: the appliance ended without a result; its console is in $log" >&2
    fi
}

# result NAME: prints a file that takt wrote into the appliance's /out.
result() {
    cpio --extract --to-stdout --quiet "$1" <"$work/results"
}
