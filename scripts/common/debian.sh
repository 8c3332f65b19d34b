# A disk with Debian for a Linux guest, made of the archive's own packages, and the kernel in it for Takt, which
# boots from files of the host. Sourced by guest-image; expects packages.sh and images.sh.
# shellcheck shell=bash

# What a Debian needs to start in a partition, to be logged into and to install more.
debian_packages=(systemd-sysv udev dbus libpam-systemd initramfs-tools linux-image-cloud-amd64
    openssh-server ca-certificates iproute2 iputils-ping e2fsprogs kmod less login nano netbase passwd procps
    # Without it Debian 12 would take Perl to merge /usr.
    usr-is-merged zstd)

# debian_main ARGUMENT...: all that begins with --debian.
debian_main() {
    parse_debian_arguments "$@"
    if [[ $debian_what == kernel ]]; then
        need_packages e2fsprogs
        [[ -e $debian_folder/disk.img ]] || fail "there is no $debian_folder/disk.img"
        copy_debian_kernel "$debian_folder"
        return
    fi
    if [[ $debian_what == tests ]]; then
        one_build_at_a_time
        make_visitors
    fi
    make_debian
}

parse_debian_arguments() {
    debian_what=${1#--debian}
    debian_what=${debian_what#-}
    debian_release=
    debian_folder=$root/target/debian
    debian_more=
    debian_size=1G
    ssh_key=
    password=
    no_password=
    shift
    if [[ $debian_what != kernel && ${1--} != -* ]]; then
        debian_release=$1
        shift
    fi
    while (($#)); do
        case $1 in
        --out | --ssh-key | --password | --include | --size)
            (($# >= 2)) || debian_usage "$1 needs a value"
            case $1 in
            --out) debian_folder=$(realpath -m -- "$2") ;;
            --ssh-key) ssh_key=$2 ;;
            --password) password=$2 ;;
            --include) debian_more=$2 ;;
            --size) debian_size=$2 ;;
            esac
            shift
            ;;
        --no-password) no_password=yes ;;
        --help | -h) help_or_usage "$1" ;;
        *) debian_usage "unknown option $1" ;;
        esac
        shift
    done
    case $debian_what in
    kernel) return ;;
    tests)
        debian_folder=$built/debian-tests
        debian_size=400M
        ssh_key=$debian_folder/visitors/key.pub
        no_password=yes
        ;;
    esac
    check_debian_arguments
}

check_debian_arguments() {
    local own=${suite:-$(os_release VERSION_CODENAME)}
    [[ -n $debian_release ]] || case $own in bookworm | trixie) debian_release=$own ;; *) debian_release=trixie ;; esac
    [[ $debian_release == @(bookworm|trixie) ]] ||
        debian_usage "\"$debian_release\" is no Debian that has been tried: bookworm (12) or trixie (13)"
    [[ -n $ssh_key$password$no_password ]] ||
        debian_usage "say who may log in as root: --ssh-key FILE, --password FILE, or --no-password"
    [[ -z $password || -z $no_password ]] || debian_usage "either --password or --no-password"
    [[ -z $ssh_key || -s $ssh_key || $debian_what == tests ]] || debian_usage "$ssh_key is not there, or empty"
    if [[ -s $ssh_key ]] && ! grep -Eq '^(ssh|ecdsa|sk)-' "$ssh_key"; then
        debian_usage "$ssh_key holds no public key; the file with it ends in .pub"
    fi
    [[ -z $password || -s $password ]] || debian_usage "$password is not there, or empty"
    [[ $debian_size =~ ^[0-9]+[MG]$ ]] || debian_usage "\"$debian_size\" is no size such as 1G or 800M"
    [[ $debian_more =~ ^[a-z0-9+.,-]*$ ]] || debian_usage "\"$debian_more\" is no list of packages with commas"
}

debian_usage() {
    echo "guest-image: $*; see scripts/guest-image --help" >&2
    exit 2
}

# make_debian: the disk, and its kernel beside it.
make_debian() {
    local inputs disk=$debian_folder/disk.img
    inputs=$(debian_inputs)
    if [[ -e $disk ]]; then
        if inputs_unchanged "$debian_folder/inputs" "$inputs" || ! debian_untouched; then
            echo "guest-image: $disk is there and stays as it is; to have it made anew, remove it" >&2
            return
        fi
    fi
    need_packages debian-archive-keyring e2fsprogs mmdebstrap
    mkdir -p "$debian_folder" "$cache"
    work=$(mktemp -d "$cache/debian.XXXXXX")
    # Broken off, the installation may leave parts of this machine mounted there.
    trap 'as_root rm -rf --one-file-system "$work"' EXIT
    # Who unpacks the packages may not be who owns this folder.
    chmod 755 "$work"
    echo "guest-image: making a disk with Debian ($debian_release), which takes some minutes" >&2
    install_debian "$work/root"
    finish_debian "$work/root"
    truncate --size="$debian_size" "$work/disk.img"
    as_root mke2fs -q -F -t ext4 -T default -b 4096 -L debian -d "$work/root" "$work/disk.img" ||
        fail "Debian does not fit into $debian_size; --size says how large the disk is"
    copy_debian_kernel "$work"
    # The making took minutes, in which a run may have begun.
    if [[ -e $disk ]]; then
        exec {disk_lock}<"$disk"
        { flock --nonblock "$disk_lock" && debian_untouched; } ||
            fail "$disk is in use or was written to meanwhile, and stays as it is"
    fi
    # Broken off from here on, it is made anew the next time: without these nothing there is taken for whole.
    rm -f "$debian_folder/inputs"
    mv "$work"/{vmlinuz,initrd.img} "$debian_folder/"
    mv "$work/disk.img" "$disk.new"
    touch "$debian_folder/made" --reference "$disk.new"
    mv "$disk.new" "$disk"
    echo "$inputs" >"$debian_folder/inputs"
}

# make_visitors: what tests of whole machines do to a Debian: a client for ssh with its libraries and its key, a
# checker of file systems without libraries, and a repository with one package.
make_visitors() {
    local folder=$debian_folder/visitors client checker package
    client=$(newest dropbear-bin dropbear_name unpack_dropbear)
    checker=$(newest e2fsck-static current_version download_package e2fsck-static)
    package=$(newest hello.deb current_version download_archive hello)
    [[ ! -e $folder ]] || return 0
    rm -rf "$folder.new"
    mkdir -p "$folder.new/packages"
    cp -a "$client" "$folder.new/client"
    cp "$(one_of "$client"/{usr/lib,lib}/x86_64-linux-gnu/ld-linux-x86-64.so.2)" "$folder.new/client/loader"
    cp "$(one_of "$checker"/{sbin,usr/sbin}/e2fsck.static)" "$folder.new/e2fsck"
    cp "$package"/*.deb "$folder.new/packages/"
    list_packages "$folder.new/packages"
    mkdir -p "$folder.new/client/etc"
    echo "root:x:0:0:root:/:/bin/sh" >"$folder.new/client/etc/passwd"
    visitor_program dropbearkey "$folder.new" -t ed25519 -f "$folder.new/client/key" >/dev/null 2>&1
    visitor_program dropbearkey "$folder.new" -y -f "$folder.new/client/key" | grep '^ssh-' >"$folder.new/key.pub"
    mv -T "$folder.new" "$folder"
}

# list_packages FOLDER: makes it a repository.
list_packages() {
    local file
    for file in "$1"/*.deb; do
        dpkg-deb --field "$file"
        echo "Filename: ./${file##*/}"
        echo "Size: $(stat -c %s "$file")"
        echo "SHA256: $(checksum "$file")"
        echo
    done >"$1/Packages"
}

# dropbear_name, unpack_dropbear FOLDER: for newest.
dropbear_name() {
    local packages
    packages=$(with_dependencies dropbear-bin)
    [[ -z $packages ]] || echo "dropbear-$(sha256sum <<<"$packages" | head -c 16)"
}

unpack_dropbear() {
    local names
    mapfile -t names < <(with_dependencies dropbear-bin | cut -d _ -f 1)
    unpack_packages "$1" "${names[@]}"
}

# download_archive FOLDER: the package that the folder is called after, as it is.
download_archive() {
    local package=${1##*/}
    mkdir -p "$1.new"
    (cd "$1.new" && apt-get "${apt[@]}" -qq download "${package%%_*}") >&2 && mv -T "$1.new" "$1"
}

# visitor_program NAME FOLDER ARGUMENT...: runs a program of the client's with its own libraries.
visitor_program() {
    local client=$2/client libraries
    libraries=$client/usr/lib/x86_64-linux-gnu:$client/lib/x86_64-linux-gnu
    "$client/loader" --library-path "$libraries" "$client/usr/bin/$1" "${@:3}"
}

# debian_inputs: prints what the disk depends on, but for the packages: a new version is no reason to make a disk anew.
debian_inputs() {
    local parts
    mapfile -t parts < <(find "$root/scripts/guest/debian" -type f | LC_ALL=C sort)
    echo "$debian_release $debian_size $debian_more $no_password $(checksum "$root/scripts/common/debian.sh" \
        "${parts[@]}" ${ssh_key:+"$ssh_key"} ${password:+"$password"})"
}

# debian_untouched: whether nobody has written to the disk since it was made.
debian_untouched() {
    [[ -e $debian_folder/made && ! $debian_folder/disk.img -nt $debian_folder/made ]]
}

# install_debian TREE: the packages.
install_debian() {
    local names sources log=$work/log
    names=$(IFS=, && echo "${debian_packages[*]}")
    sources=$(name_sources "$debian_release-deb")
    sources+=$'\n'$(sed -n "1s/ $debian_release / $debian_release-updates /p" <<<"$sources")
    # Hooks get the tree as $1.
    # shellcheck disable=SC2016
    as_root mmdebstrap --quiet --mode=root --variant=apt --architectures=amd64 \
        --keyring=/usr/share/keyrings/debian-archive-keyring.gpg \
        --aptopt='APT::Install-Recommends "false"' --aptopt='Acquire::Languages "none"' \
        --dpkgopt="$root/scripts/guest/debian/etc/dpkg/dpkg.cfg.d/no-manuals" \
        --dpkgopt=force-unsafe-io \
        --essential-hook="tar -C '$root/scripts/guest/debian' --owner=0 --group=0 --mode=u=rwX,go=rX -c . |
            tar -C \"\$1\" --no-overwrite-dir -x" \
        --customize-hook='chroot "$1" systemctl --quiet enable systemd-networkd sshd-vsock.socket' \
        --customize-hook='chroot "$1" systemctl --quiet disable getty@tty1' \
        --include="$names${debian_more:+,$debian_more}" \
        "$debian_release" "$1" - <<<"$sources" >"$log" 2>&1 || {
        cat "$log" >&2
        fail "mmdebstrap could not make Debian ($debian_release)"
    }
}

# finish_debian TREE: what packages leave open.
finish_debian() {
    # These were for the installation only; from here on apt and dpkg are as Debian has them.
    as_root rm -f "$1/etc/apt/apt.conf.d/99mmdebstrap" "$1/etc/dpkg/dpkg.cfg.d/99mmdebstrap"
    # An empty file is filled at the first start. Without one systemd would switch on every service.
    as_root truncate --size=0 "$1/etc/machine-id"
    # Nothing has changed since the packages were set up, so the first start need not bring caches up to date.
    as_root touch "$1/etc/.updated" "$1/var/.updated"
    name_servers | as_root tee "$1/etc/resolv.conf" >/dev/null
    if [[ -n $no_password ]]; then
        as_root chroot "$1" passwd --quiet --delete root
    elif [[ -n $password ]]; then
        printf 'root:%s\n' "$(head -n 1 "$password")" | as_root chroot "$1" chpasswd
    fi
    if [[ $debian_what == tests ]]; then
        as_root cp -r --no-preserve=ownership "$debian_folder/visitors/packages" "$1/srv/"
    fi
    if [[ -n $ssh_key ]]; then
        as_root install -d -m 700 "$1/root/.ssh"
        as_root install -m 600 "$ssh_key" "$1/root/.ssh/authorized_keys"
    fi
}

# name_servers: prints those of this machine that others can reach, too.
name_servers() {
    local file=/run/systemd/resolve/resolv.conf
    [[ -e $file ]] || file=/etc/resolv.conf
    grep '^nameserver' "$file" | grep -v '^nameserver *\(127\.\|::1\)' || true
}

# copy_debian_kernel FOLDER: the kernel that the disk in this folder has, and its initial RAM disk, to files beside it.
# Those before are kept with the ending .old.
copy_debian_kernel() {
    local disk=$1/disk.img name new
    # Takt holds this lock while it runs.
    flock --nonblock --shared "$disk" true || fail "$disk is in use: end the run first"
    if dumpe2fs -h "$disk" 2>/dev/null | grep -q '^Filesystem features:.* needs_recovery'; then
        fail "the file system in $disk was not unmounted: run Takt until Linux has switched itself off, or" \
            "mend it with: e2fsck -p $disk"
    fi
    for name in vmlinuz initrd.img; do
        new=$(debian_link "$disk" "$name")
        rm -f "$1/$name.new"
        # A command of debugfs ends a word at each blank.
        (cd "$1" && debugfs -R "dump /$new $name.new" "$disk" 2>/dev/null)
        [[ -s $1/$name.new ]] || fail "$disk has no /$name that leads to a file"
    done
    for name in vmlinuz initrd.img; do
        if [[ -e $1/$name ]] && ! cmp --quiet "$1/$name" "$1/$name.new"; then
            mv "$1/$name" "$1/$name.old"
        fi
        mv "$1/$name.new" "$1/$name"
    done
    echo "guest-image: kernel ${new#*/initrd.img-} is in $debian_folder" >&2
}

# debian_link DISK NAME: prints where the link /NAME leads. Debian has one for the newest kernel and its RAM disk.
debian_link() {
    debugfs -R "stat /$2" "$1" 2>/dev/null | sed -n 's/^Fast link dest: "\(.*\)"$/\1/p'
}
