# Kernels and initramfs images, made from unpacked Debian kernel packages.
# Sourced; expects packages.sh. In each function PACKAGE is a folder from fetch_kernel.
# shellcheck shell=bash

# one_build_at_a_time: the rest of the script runs in one process only, since tests start
# several runs at once and all of them may find the same image missing.
one_build_at_a_time() {
    mkdir -p "$cache"
    exec {build_lock}>"$cache/lock"
    flock "$build_lock"
}

# appliance_folder FLAVOUR: where the appliance with this kernel flavour is.
appliance_folder() {
    local folder=$built/appliance
    [[ $1 == rt-amd64 ]] || folder+=-$1
    echo "$folder"
}

# find_busybox: prints the path of a busybox that needs no libraries.
find_busybox() {
    local folder
    if [[ -z $suite ]]; then
        need_packages busybox-static
        echo /bin/busybox
    else
        folder=$(newest busybox-static current_version download_package busybox-static) || return
        one_of "$folder"/{bin,usr/bin}/busybox
    fi
}

# stand_in NAME...: a check of a partition file looks at target/guest, whatever suite is to be run. What this
# machine's own packages have not been used for yet is a link there.
stand_in() {
    local name
    [[ -n $suite ]] || return 0
    mkdir -p "$root/target/guest"
    for name in "$@"; do
        [[ -e $root/target/guest/$name ]] || ln -sf "../$suite/guest/$name" "$root/target/guest/$name"
    done
}

# inputs_unchanged STAMP INPUTS FILE...: whether STAMP says that the files were made from INPUTS, and each is there, and is not a
# link to that of another suite (stand_in).
inputs_unchanged() {
    local file
    for file in "${@:3}"; do
        [[ -s $file && ! -L $file ]] || return 1
    done
    [[ -e $1 && $(<"$1") == "$2" ]]
}

# checksum FILE...: one checksum of all of them.
checksum() {
    cat "$@" | sha256sum | cut -d " " -f 1
}

# kernel_release PACKAGE: what `uname -r` says under this kernel.
kernel_release() {
    local kernel
    kernel=$(echo "$1"/boot/vmlinuz-*)
    echo "${kernel##*/vmlinuz-}"
}

# copy_modules PACKAGE ROOT NAME...: copies modules and what they depend on below
# ROOT/lib/modules, uncompressed and with modules.dep.
copy_modules() {
    local package=$1 target=$2 release module
    shift 2
    release=$(kernel_release "$package")
    mkdir -p "$target/lib/modules/$release"
    index_modules "$package" "$release"
    cp "$package/lib/modules/$release"/modules.{order,builtin,builtin.modinfo} \
        "$target/lib/modules/$release/"
    module_files "$package" "$@" | while read -r module; do
        copy_module "$module" "$target/lib/modules/$release"
    done
    depmod -b "$target" "$release"
}

# module_files PACKAGE NAME...: prints the files to load, in order, each once. What the kernel
# has built in is left out.
module_files() {
    local package=$1 release
    shift
    release=$(kernel_release "$package")
    index_modules "$package" "$release"
    modprobe -d "$package" -S "$release" --show-depends -a "$@" |
        awk '$1 == "insmod" && !seen[$2]++ { print $2 }'
}

# Newer packages keep their modules below usr/; kmod looks below lib/.
index_modules() {
    [[ -e $1/lib ]] || ln -s usr/lib "$1/lib"
    [[ -e $1/lib/modules/$2/modules.dep ]] || depmod -b "$1" "$2"
}

# copy_module FILE FOLDER: uncompressed, so that neither the kernel nor busybox has to.
copy_module() {
    local name=${1##*/}
    case $name in
    *.ko) cp "$1" "$2/$name" ;;
    *.ko.xz) xz -dc "$1" >"$2/${name%.xz}" ;;
    *.ko.zst) zstd -qdc "$1" >"$2/${name%.zst}" ;;
    *) fail "unknown compression of $1" ;;
    esac
}

# pack FOLDER: prints FOLDER as an initramfs archive, the same bytes for the same files, which all get the
# same date for that. It is not compressed: unpacking takes longer than reading where the CPU is
# emulated.
pack() {
    find "$1" -exec touch --no-dereference --date=@1000000000 {} +
    (cd "$1" && find . -mindepth 1 -print0 | LC_ALL=C sort -z |
        cpio --null --create --format=newc --quiet --reproducible --owner=0:0)
}

# unpack_kernel BZIMAGE: prints the ELF kernel inside, found through the fields setup_sects,
# payload_offset and payload_length of the setup header (Linux Documentation/arch/x86/boot.rst).
# QEMU starts it by its PVH entry, which saves the decompression: seconds where the CPU is
# emulated.
unpack_kernel() {
    local sectors offset length magic tool
    sectors=$(number_at "$1" 0x1f1 1)
    offset=$(((sectors + 1) * 512 + $(number_at "$1" 0x248 4)))
    length=$(number_at "$1" 0x24c 4)
    magic=$(od -An -tx1 -j "$offset" -N 4 "$1" | tr -d ' ')
    case $magic in
    fd377a58) tool=(xz -dc) ;;
    28b52ffd) tool=(zstd -qdc) ;;
    1f8b*) tool=(gzip -dc) ;;
    02214c18)
        need_packages lz4
        tool=(lz4 -dcq)
        ;;
    *) fail "unknown compression of the kernel $1" ;;
    esac
    # The last four bytes are the kernel's length and not part of the compressed stream.
    length=$((length - 4))
    head -c $((offset + length)) "$1" | tail -c "$length" | "${tool[@]}"
}

# number_at FILE OFFSET BYTES: an unsigned little-endian number.
number_at() {
    od -An -t "u$3" -j $(($2)) -N "$3" "$1" | tr -d ' '
}

# build_hooked_takt: Takt for tests that make it fail. What users get is built without the feature and in another folder.
build_hooked_takt() {
    (cd "$root" && cargo build --quiet --profile hooks --package takt --bin takt --features test-hooks)
}
