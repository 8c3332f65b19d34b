# Runs the appliance in Bochs, which emulates what QEMU does not: Intel's VMX, for kvm-intel; and AMD's SVM a
# second time, in other code. Sourced by emulator.sh; bochs_machine uses the variables of nested.sh.
# shellcheck shell=bash
# The variables are those of nested.sh.
# shellcheck disable=SC2034,SC2154

# Where the initial RAM disk and the kernel's command line lie in the machine's memory: behind the
# kernel, and before what the firmware has at the end.
initrd_start=$((0x8000000))
words_start=$((initrd_start - 0x1000))

# build_bochs: sets $emulator to what the report says of Bochs, and says it in one line.
build_bochs() {
    need_packages binutils
    "$root/scripts/bochs"
    emulator="Bochs $(<"$root/target/bochs/version"), healed: an interrupt ends a guest that has interrupts off"
    echo "${0##*/}: $emulator" >&2
}

# bochs_machine: sets $machine to Bochs with the command line of $kernel_words and $words, its console on standard output, and
# $output.
bochs_machine() {
    local line
    # Bochs knows no end at a restart, but one at a triple fault. It counts each repetition of an
    # instruction: without these two features kernels move eight bytes by one, as in the lab.
    kernel_words+=" reboot=triple clearcpuid=erms,fsrm"
    # By the firmware's tables for ACPI, all functions of PCI but the bridge are unplugged, and Linux takes them away.
    [[ -z ${control_line-} ]] || kernel_words+=" acpiphp.disable=1"
    line=$(command_line)
    printf '%s\0' "$line" >"$work/words"
    make_initrd
    objcopy --output-target=binary "$appliance/vmlinux" "$work/kernel"
    make_disk
    open_console
    configure_bochs
    # Bochs shows its clock in local time.
    machine=(env TZ=UTC ${control_line:+"BOCHS_SHARED_MEMORY=$control_line"} ${allocation:+BOCHS_ALLOCATION=yes}
        "$root/target/bochs/bochs" -q -f "$work/bochsrc")
    # What the appliance writes to port 0xe9 is Bochs's output. Its errors are what it has to say at the
    # end, which it has always.
    exec {output}>"$work/results" {errors}>"$work/bochs.log"
}

# make_disk: the disk to start from, which holds only the loader.
make_disk() {
    local entry
    entry=$(pvh_entry)
    [[ -n $entry ]] || fail "$appliance/vmlinux has no entry by PVH, which Bochs's loader needs"
    as --32 -o "$work/loader.o" "$root/scripts/common/bochs-loader.s" \
        --defsym "kernel_entry=$entry" --defsym "words_start=$words_start" \
        --defsym "initrd_start=$initrd_start" \
        --defsym "initrd_bytes=$(stat -c %s "$work/initrd")"
    ld -m elf_i386 --oformat=binary -Ttext=0x7c00 -o "$work/disk" "$work/loader.o"
    # A cylinder of 16 heads and 63 sectors.
    truncate --size=$((16 * 63 * 512)) "$work/disk"
}

# kernel_start: prints where the kernel is to lie in memory.
kernel_start() {
    readelf --segments --wide "$appliance/vmlinux" | awk '$1 == "LOAD" && !seen++ { print $4 }'
}

# pvh_entry: prints the address of the kernel's entry by PVH, which is in the note with number 18.
pvh_entry() {
    readelf --notes --wide "$appliance/vmlinux" |
        sed -n 's/.*(0x00000012).*data: \(..\) \(..\) \(..\) \(..\) .*/0x\4\3\2\1/p'
}

# configure_bochs: $work/bochsrc. With a billion instructions a second and a clock that follows
# nothing else, an instruction is a nanosecond as in the lab, and what is drawn at random is left out. The screen's
# own clock is real time otherwise, and its ticks moved interrupts of the run by some nanoseconds.
configure_bochs() {
    local model megabytes
    case $lane in
    vmx) model=corei7_ivy_bridge_3770k ;;
    svm) model=ryzen ;;
    esac
    megabytes=$(machine_memory)
    ((megabytes <= 2048)) || fail "$megabytes MiB are needed, and Bochs has at most 2048 for a machine"
    cat >"$work/bochsrc" <<END
display_library: nogui
cpu: model=$model, exclude_features="rdrand,rdseed", ips=1000000000, reset_on_triple_fault=0, ignore_bad_msrs=1
clock: sync=none, time0=1893456000
memory: guest=$megabytes, host=$megabytes
romimage: file="$root/target/bochs/bios.bin", options=fastboot
vgaromimage: file="$root/target/bochs/vgabios.bin"
vga: extension=vbe, update_freq=5, realtime=0
optramimage1: file="$work/kernel", address=$(kernel_start)
optramimage2: file="$work/initrd", address=$(printf '0x%x' "$initrd_start")
optramimage3: file="$work/words", address=$(printf '0x%x' "$words_start")
pci: enabled=1, chipset=i440fx
ata0: enabled=1, ioaddr1=0x1f0, ioaddr2=0x3f0, irq=14
ata0-master: type=disk, path="$work/disk", mode=flat
boot: disk
com1: enabled=1, mode=file, dev=/dev/fd/$console
port_e9_hack: enabled=1
log: /dev/null
panic: action=fatal
error: action=ignore
info: action=ignore
debug: action=ignore
END
}

# open_console: sets $console to a descriptor for what the serial port sends.
open_console() {
    # Ctrl-C is for the script, which ends Bochs, and with it the console.
    exec {console}> >(exec tee --ignore-interrupts "$work/console.log")
    console_reader=$!
}

# close_console: waits until all of it has been shown. Behind it in the file is what Bochs said.
close_console() {
    exec {console}>&-
    wait "$console_reader" || true
    cat "$work/bochs.log" >>"$work/console.log"
}
