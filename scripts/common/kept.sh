# What is kept of a run in an emulated machine: the files that takt has left there, and what is drawn from them.
# Sourced by scripts/run. The caller sets:
#   command_line, duration, jitter_options  how it was called
#   records                       what channels have recorded, as `takt check --needs` tells it
#   status                        the exit status so far
#   takt                          the program
#   work                          a folder for temporary files
# shellcheck shell=bash
# shellcheck disable=SC2154

# draw: shows what was measured. Only takt runs in the appliance; what draws runs here.
draw() {
    local outcome=0
    keep_result report.json "$work/report.json"
    keep_result samples.json "$work/samples.json"
    # The status tells why there is none.
    [[ -e $work/report.json && -e $work/samples.json ]] || return 0
    "$takt" jitter render --report "$work/report.json" --samples "$work/samples.json" \
        --command "$command_line" ${duration:+--for "$duration"} "${jitter_options[@]}" || outcome=$?
    ((status)) || status=$outcome
}

# keep_result NAME FILE: copies a result to FILE, if one is wanted. A run that failed may have left none, and has
# said why. One that ended well is not good without it: the status becomes 3.
keep_result() {
    [[ -n $2 ]] || return 0
    if result "$1" >"$work/kept" 2>/dev/null && [[ -s $work/kept ]]; then
        cp "$work/kept" "$2" || {
            trap restore_terminal EXIT
            echo "${0##*/}: $1 cannot be written to $2, and stays in $work/kept" >&2
            exit 3
        }
    elif ((status == 0)); then
        echo "${0##*/}: takt ended well, and its $1 cannot be read from what the machine left" >&2
        status=3
    fi
}

# keep_records: appends what channels have recorded to their files, as takt does where it runs here. A run that ended well
# has a file for each of them, which may be empty. It is not good without: the status becomes 3.
keep_records() {
    local record
    for record in "${records[@]}"; do
        if ! result "${record%% *}.records" >"$work/kept" 2>/dev/null; then
            ((status)) || {
                echo "${0##*/}: takt ended well, and the records of ${record%% *} cannot be read from what the machine left" >&2
                status=3
            }
        elif [[ -s $work/kept ]] && ! (umask 077 && cat "$work/kept" >>"${record#* }"); then
            echo "${0##*/}: the records of ${record%% *} cannot be written to ${record#* }" >&2
            status=3
        fi
    done
}
