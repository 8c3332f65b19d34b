# A browser without a screen for tests of pages: Debian's chromium-headless-shell with what it is linked to, unpacked
# and not installed. Sourced by guest-image; expects packages.sh and images.sh.
# shellcheck shell=bash

# Of these packages a browser without a screen, a graphics processor and the X Window System needs nothing.
not_for_browser='^(libllvm|libz3|libgl1|libglx|libglapi|libdrm-[ainr]|libsensors|libpciaccess|x11-|xdg-|libicu|libxml2|xkb-data'
not_for_browser+='|gcc-|sysvinit|debconf|lsb-base|libice6|libsm6|libxt6|libxmu|libxpm|libxaw|libxft|libxinerama|libxkbfile'
not_for_browser+='|libxtst|libxv1|libxxf86|at-spi2-common)'

# make_browser: $built/browser, the root of a file system with the browser's programs.
make_browser() {
    local newest_browser
    newest_browser=$(newest browser browser_name unpack_browser)
    ln -sfn "$newest_browser" "$built/browser"
}

browser_packages() {
    with_dependencies chromium-headless-shell | grep -Ev "$not_for_browser" || true
}

# browser_name, unpack_browser FOLDER: for newest.
browser_name() {
    local packages
    packages=$(browser_packages)
    [[ -z $packages ]] || echo "browser-$(echo "$packages" | checksum "$root/scripts/common/browser.sh" - | head -c 16)"
}

unpack_browser() {
    local names
    mapfile -t names < <(browser_packages | cut -d _ -f 1)
    # What an interrupted one has left.
    rm -rf "$1.new"
    unpack_packages "$1.new" "${names[@]}" || return 1
    # What a run carries into its machine is memory there.
    rm -rf "$1.new"/usr/share/{doc,man,locale,lintian,bug,X11} \
        "$1.new"/usr/lib/chromium/{libVk*,libvk*,libvulkan*,libGLES*,libEGL*,chrome_crashpad_handler,chrome_200*}
    mkdir -p "$1.new"/{dev,proc,tmp}
    mv -T "$1.new" "$1"
}
