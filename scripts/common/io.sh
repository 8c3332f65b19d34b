# What the comparison of disks and networks takes: iperf3, fio, and QEMU as a VMM of its own.
# Sourced; expects packages.sh and emulator.sh.
# shellcheck shell=bash

# find_io_tools: sets $io_tools, a folder with these programs, the libraries that they are linked to and QEMU's firmware, all in
# one place, to be started as   ld-linux-x86-64.so.2 --library-path FOLDER FOLDER/PROGRAM   wherever it lies; and
# $io_guest, the same with what the guest needs of it.
find_io_tools() {
    local vmm measuring
    vmm=$(one_build_at_a_time && newest qemu current_qemu download_qemu) || exit
    measuring=$(one_build_at_a_time && newest io current_io download_io) || exit
    io_tools=$results/io/tools
    io_guest=$results/io/guest/io
    rm -rf "$results/io"
    mkdir -p "$io_tools" "$io_guest"
    flatten "$measuring" "$io_guest" fio iperf3
    # Of the programs, iperf3 is wanted on both sides. What QEMU is linked to may be newer.
    flatten "$measuring" "$io_tools" iperf3
    flatten "$vmm" "$io_tools" qemu-system-x86_64
    cp "$vmm"/usr/share/seabios/bios{-256k,-microvm}.bin "$vmm"/usr/share/qemu/{kvmvapic,linuxboot_dma}.bin "$io_tools/"
}

# flatten TREE FOLDER PROGRAM...: copies programs of unpacked packages, and all that they are linked to.
flatten() {
    local tree=$1 folder=$2 loader name libraries
    loader=$(one_of "$tree"/{lib,usr/lib}/x86_64-linux-gnu/ld-linux-x86-64.so.2)
    libraries=$tree/lib/x86_64-linux-gnu:$tree/usr/lib/x86_64-linux-gnu
    cp --dereference "$loader" "$folder/"
    for name in "${@:3}"; do
        cp "$tree/usr/bin/$name" "$folder/"
        [[ $name != fio ]] || without_remote_engines "$folder"
        "$loader" --inhibit-cache --library-path "$folder:$libraries" --list "$folder/$name" 2>/dev/null |
            awk '$3 ~ /^\// && !/not found/ { print $3 }' | while read -r file; do
            [[ $file -ef $folder/${file##*/} ]] || cp --dereference "$file" "$folder/"
        done
    done
}

# without_remote_engines FOLDER: Debian's fio is linked to the clients of storage that is elsewhere (Ceph, Gluster, RDMA), 80 MiB with
# what they need, which each start would link again. A library with nothing behind their names stands in for them.
without_remote_engines() {
    local symbols name
    symbols=$(nm -D --undefined-only "$1/fio" | awk '$2 ~ /^(glfs|nbd|ibv|rdma|rados|rbd|pmem|pmemblk)_/ { print $2 }')
    sed 's/@.*//; s/.*/void &(void) {}/' <<<"$symbols" |
        cc -shared -nostdlib -x c -o "$1/remote.so" -Wl,--version-script=<(
            awk -F @ 'NF == 2 { of[$2] = of[$2] " " $1 ";" } END { for (v in of) print v " {" of[v] " };" }' <<<"$symbols"
        ) -
    objdump -p "$1/fio" | awk '$1 == "NEEDED" && $2 ~ /^lib(gfapi|nbd|ibverbs|rdmacm|rados|rbd|pmem|pmemblk)\.so/ { print $2 }' |
        while read -r name; do ln -sf remote.so "$1/$name"; done
}

# io_packages: prints the package files of iperf3 and fio with all that they depend on.
io_packages() {
    with_dependencies fio iperf3
}

current_io() {
    local packages
    packages=$(io_packages)
    [[ -z $packages ]] || echo "io-$(sha256sum <<<"$packages" | head -c 16)"
}

download_io() {
    local names
    mapfile -t names < <(io_packages | cut -d _ -f 1)
    unpack_packages "$1" "${names[@]}"
}
