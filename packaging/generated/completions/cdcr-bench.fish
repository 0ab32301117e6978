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
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "all" -d 'Everything, as one report with the machine\'s description: text, JSON, CSV, plots, raw histograms, and a page that holds all of it'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "deadline" -d 'Deadline misses and latencies of the daemon under named loads, beside a bare loop in the same run'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "latency" -d 'How long messages take: reference, obstacle, measurement, request and stop, beside iceoryx2 alone'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "rate" -d 'How fast the loop can go: the shortest period that a real daemon holds with 1, 2 and 3 sections, every solver and two horizons, and what ends it'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "footprint" -d 'What a daemon takes at 200 Hz: share of a core of each thread, memory, files, time to start'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "quality" -d 'What time buys: error, clearance and cost against the budget of a solve, the swarm and the horizon, on the paper\'s and on harder scenes, and how often a solver gets stuck'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "robustness" -d 'Robots that are not their model (lag, noise, play, another geometry, a load): the true error of the tip, and what each part of the controller is for'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "paper" -d 'The paper\'s three simulations (spiral, line with orientation, circle with an obstacle) with every solver, beside the paper\'s figures'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "solver" -d 'Solve times on every path of this processor, and how they grow with sections, steps, particles, iterations and obstacles'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "budget" -d 'How much later than its budget a solve ends, from no time at all to 1 ms, and that its plan is never worse than the warm start'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "compare" -d 'What changed between two runs beyond the noise of their rounds'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "peer" -d 'The other process of `latency`'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l out -d 'Folder for the report: report.html, report.txt, report.json, a CSV for each table, plots as SVG, raw histograms; made if it does not exist, written into at the end only' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l rounds -d 'Rounds of each benchmark, 1 to 100, instead of the usual number of each; compare needs at least 3' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l only -d 'Only these, separated by commas' -r -f -a "deadline\t'Deadline misses and latencies of the daemon under named loads, beside a bare loop in the same run'
latency\t'How long messages take: reference, obstacle, measurement, request and stop, beside iceoryx2 alone'
rate\t'How fast the loop can go: the shortest period that a real daemon holds with 1, 2 and 3 sections, every solver and two horizons, and what ends it'
footprint\t'What a daemon takes at 200 Hz: share of a core of each thread, memory, files, time to start'
quality\t'What time buys: error, clearance and cost against the budget of a solve, the swarm and the horizon, on the paper\'s and on harder scenes, and how often a solver gets stuck'
robustness\t'Robots that are not their model (lag, noise, play, another geometry, a load): the true error of the tip, and what each part of the controller is for'
paper\t'The paper\'s three simulations (spiral, line with orientation, circle with an obstacle) with every solver, beside the paper\'s figures'
solver\t'Solve times on every path of this processor, and how they grow with sections, steps, particles, iterations and obstacles'
budget\t'How much later than its budget a solve ends, from no time at all to 1 ms, and that its plan is never worse than the warm start'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l config -d 'Configuration of the daemon in deadline and latency; without it the default, three sections. The other benchmarks choose their own, and with it no figure to reach is judged' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l quick -d 'A look of a few minutes that proves little'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l duration -d 'Measured time of each subject under each load, all rounds together' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l load -d 'What else the machine does meanwhile, on the cores of the client; several with commas. Without this option, every load but stress-ng, one after the other' -r -f -a "none\t'Nothing'
cpu\t'A thread that computes on each core but the real-time one'
memory\t'A thread on each core but the real-time one that copies memory far larger than the caches'
io\t'A thread that writes a file of 64 MiB, syncs it every 4 MiB, and reads it back from the disk'
clients\t'30 clients a second that connect to the daemon and leave; every other one opens the telemetry'
flood\t'10 000 reference chunks a second of a client without the lease, and 10 000 obstacle updates a second, far out of reach: sent, not taken. The daemon\'s queues hold 32 chunks and 16 updates, and one gather takes 8 updates; the rest overflows. What is taken of the chunks is refused, of the updates accepted'
all\t'cpu, memory, io, clients and flood at once'
cpu-everywhere\t'Threads that compute and copy memory on every core, also on the real-time one'
stress-ng\t'stress-ng, if it is installed: processor, memory and sync, on each core but the real-time one'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l rounds -d 'Rounds, in each of which every subject runs once under every load, 1 to 1000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l period -d 'Period of the loop, if another one than the configuration\'s' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l config -d 'Configuration of the daemon; without it the default, three sections' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l setup -d 'Which set-up of the threads' -r -f -a "both\t'Real time under every load, and without it under the loads that show the difference best'
realtime\t'Only with real time'
ordinary\t'Only without'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l rounds -d 'Rounds, in each of which everything is measured once, 1 to 1000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l samples -d 'Samples of each kind in each round, 5 to 10000; two fifths of that for stops, eight times that for iceoryx2 alone' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l period -d 'Period of the loop, if another one than the configuration\'s' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l config -d 'Configuration of the daemon; without it the default, three sections' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l quick -d 'A quick look: 2 rounds of 40 samples'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l rounds -d 'How often the default is measured with each of its periods, 1 to 100. The search for the shortest periods is made once' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l spin -d 'Let the daemon wake up so long before each release and spin to it, 0 (no rehearsal) to 1000 µs; at most a quarter of the period. Without it, as the daemon does by default' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l quick -d 'The default and its solvers only, in short trials: a look of half a minute instead of a measurement of five'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l rounds -d 'Daemons that are measured one after the other, 1 to 100' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l duration -d 'How long each of them tracks, 100ms to 1h; without a client it is measured for two fifths of that' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l quick -d 'Two daemons for two seconds: a look of ten seconds instead of a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l rounds -d 'Runs of each variant, each with another seed, 1 to 100' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l quick -d 'One round of a part of it: a look of some seconds, no measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l seeds -d 'Runs of each robot with each controller, each with other noise, 1 to 1000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l only -d 'Only the ideal robot, which others are compared with, and those with TEXT in their name; with --sweep, only the presets and the knobs with TEXT in their key ("preset" for none of these)' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l sweep -d 'Turn one knob after the other instead, on the robot of the laboratory: the tables and the picture of docs/tuning.md'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l seeds -d 'Runs of each solver, each with another seed, 1 to 1000. kpso-refined draws the circle at least 20 times' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l rounds -d 'How often all sizes are measured, 1 to 100; a number is the median' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l rounds -d 'How often all budgets are measured, 1 to 100; a time is the median, the largest of all' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l solves -d 'Solves of each case with each budget in a round, 1 to 1000000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l format -d 'How to print the result' -r -f -a "text\t'A table for people'
markdown\t'The same table for a page on the web'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l out -d 'Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if it does not exist' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand compare" -l format -d 'How to print the result' -r -f -a "text\t'What changed, for people'
json\t'One JSON object with every number'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand compare" -l fail-on-worse -d 'Exit status 1 when more numbers changed for the worse, beyond noise, than chance explains: than half of those that chance alone would call changed, rounded up, and two more. Numbers with one value each do not count'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand compare" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand peer" -l prefix -d 'Prefix of the files in shared memory' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand peer" -l root -d 'Root folder of iceoryx2' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand peer" -l parent -d 'The process that started it' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand peer" -l core -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand peer" -l shares -d 'Both processes are on one core: let the other one run'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand peer" -s h -l help -d 'Print help'
