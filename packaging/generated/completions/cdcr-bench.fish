# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_cdcr_bench_global_optspecs
    string join \n h/help V/version
end

function __fish_cdcr_bench_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_cdcr_bench_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_cdcr_bench_using_subcommand
    set -l cmd (__fish_cdcr_bench_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -s h -l help -d 'Print help'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -s V -l version -d 'Print version'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "paper" -d 'The paper\'s three simulations (spiral, line with orientation, circle with an obstacle) with every solver, beside the paper\'s figures'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "solver" -d 'Solve times on every path of this processor, and how they grow with sections, steps, particles, iterations and obstacles'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "budget" -d 'How much later than its budget a solve ends, from no time at all to 1 ms, and that its plan is never worse than the warm start'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l seeds -d 'Runs of each solver, each with another seed, 1 to 1000. kpso-refined draws the circle at least 20 times' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l out -d 'Folder for the figures as SVG, for paper.html with all of them, paper.json and paper.csv; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l cycles -d 'Cycles of a run at most: for a quick look' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l solves -d 'Solves of each case with each budget, 1 to 1000000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -s h -l help -d 'Print help (see more with \'--help\')'
