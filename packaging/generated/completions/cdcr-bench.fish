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
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "all" -d 'Run all benchmarks and write one report with a description of the machine: text, JSON, CSV, plots, raw histograms, and a self-contained HTML page'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "deadline" -d 'Measure deadline misses and latencies of the daemon under named loads, next to a bare loop in the same run'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "latency" -d 'Measure message latencies: reference, obstacle, measurement, request and stop, next to iceoryx2 alone'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "rate" -d 'Measure the shortest period that a daemon holds with 1, 2 and 3 sections, every solver and two horizons, and what limits it'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "footprint" -d 'Measure resource use of a daemon at 200 Hz: core share per thread, memory, files, start time'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "quality" -d 'Measure error, clearance and cost over the time budget, the swarm and the horizon, on the paper\'s and on harder scenes, and how often a solver gets stuck'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "robustness" -d 'Measure the true tip error of robots that differ from their model (lag, noise, play, geometry, load), and the effect of each part of the controller'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "paper" -d 'Run the paper\'s three simulations (spiral, line with orientation, circle with an obstacle) with every solver, next to the paper\'s results'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "solver" -d 'Measure solve times on every SIMD path of this processor, over sections, steps, particles, iterations and obstacles'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "budget" -d 'Measure by how much a solve exceeds time budgets from 0 to 1 ms, and check that its plan is never worse than the warm start'
complete -c cdcr-bench -n "__fish_cdcr_bench_needs_command" -f -a "compare" -d 'Compare two runs and list changes beyond the noise of their rounds'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l out -d 'Output folder for report.html, report.txt, report.json, a CSV per table, SVG plots and raw histograms; created if missing, written only at the end' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l rounds -d 'Rounds per benchmark, 1 to 100 [default: that of each benchmark]; compare needs at least 3' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l only -d 'Run only these benchmarks, comma-separated' -r -f -a "deadline\t'Measure deadline misses and latencies of the daemon under named loads, next to a bare loop in the same run'
latency\t'Measure message latencies: reference, obstacle, measurement, request and stop, next to iceoryx2 alone'
rate\t'Measure the shortest period that a daemon holds with 1, 2 and 3 sections, every solver and two horizons, and what limits it'
footprint\t'Measure resource use of a daemon at 200 Hz: core share per thread, memory, files, start time'
quality\t'Measure error, clearance and cost over the time budget, the swarm and the horizon, on the paper\'s and on harder scenes, and how often a solver gets stuck'
robustness\t'Measure the true tip error of robots that differ from their model (lag, noise, play, geometry, load), and the effect of each part of the controller'
paper\t'Run the paper\'s three simulations (spiral, line with orientation, circle with an obstacle) with every solver, next to the paper\'s results'
solver\t'Measure solve times on every SIMD path of this processor, over sections, steps, particles, iterations and obstacles'
budget\t'Measure by how much a solve exceeds time budgets from 0 to 1 ms, and check that its plan is never worse than the warm start'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l config -d 'Configuration of the daemon in deadline and latency [default: three sections]. The other benchmarks use their own. With this option no targets are evaluated' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -l quick -d 'Run all benchmarks in a few minutes; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand all" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l duration -d 'Total measured time per subject and load, over all rounds' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l load -d 'Loads on the cores of the client, comma-separated [default: all but stress-ng, one after the other]' -r -f -a "none\t'No load'
cpu\t'A computing thread on each core but the real-time one'
memory\t'A thread on each core but the real-time one that copies more memory than the caches hold'
io\t'A thread that writes a file of 64 MiB, syncs it every 4 MiB, and reads it back from the disk'
clients\t'30 clients per second that connect to the daemon and leave; every second one opens the telemetry'
flood\t'10 000 reference chunks per second from a client without the lease, and 10 000 updates per second of obstacles out of reach. The daemon\'s queues hold 32 chunks and 16 updates, and one gather takes 8 updates; the rest overflows. Received chunks are rejected, received updates accepted'
all\t'Loads cpu, memory, io, clients and flood at once'
cpu-everywhere\t'Threads that compute and copy memory on every core, including the real-time one'
stress-ng\t'stress-ng, if installed: processor, memory and sync, on each core but the real-time one'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l rounds -d 'Rounds, 1 to 1000: each runs every subject once under every load' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l period -d 'Period of the loop [default: as configured]' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l config -d 'Configuration of the daemon [default: three sections]' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l setup -d 'Set-up of the threads' -r -f -a "both\t'Real time under every load, and ordinary threads under the loads that show the difference best'
realtime\t'Only real time'
ordinary\t'Only ordinary threads'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand deadline" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l rounds -d 'Rounds, 1 to 1000: each measures everything once' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l samples -d 'Samples per kind and round, 5 to 10000; 2/5 of that for stops, 8 times that for iceoryx2 alone' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l period -d 'Period of the loop [default: as configured]' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l config -d 'Configuration of the daemon [default: three sections]' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand latency" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l rounds -d 'Measurements of the default at each of its periods, 1 to 100. The search for the shortest periods runs once' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l spin -d 'Let the daemon wake up this long before each release and spin, 0 (no rehearsal) to 1000 µs; at most a quarter of the period [default: that of the daemon]' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand rate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l rounds -d 'Number of daemons, measured one after the other, 1 to 100' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l duration -d 'Tracking time per daemon, 100ms to 1h; without a client it is measured for 2/5 of that' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand footprint" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l rounds -d 'Runs per variant, each with its own seed, 1 to 100' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand quality" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l seeds -d 'Runs of each robot with each controller, each with its own noise, 1 to 1000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l only -d 'Run only the ideal robot, the basis of comparison, and robots with TEXT in their name; with --sweep, only the presets and the keys that contain TEXT ("preset": only the presets)' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l sweep -d 'Vary one configuration key at a time on the laboratory robot instead: the tables and the plot of docs/tuning.md'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand robustness" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l seeds -d 'Runs per solver, each with its own seed, 1 to 1000. kpso-refined runs the circle at least 20 times' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand paper" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l rounds -d 'Rounds over all sizes, 1 to 100; results are medians' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand solver" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l rounds -d 'Rounds over all budgets, 1 to 100; a time is the median over the rounds, a maximum that of all' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l solves -d 'Solves per case and budget in a round, 1 to 1000000' -r
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l format -d 'Output format' -r -f -a "text\t'Text table'
markdown\t'Markdown table'
json\t'One JSON object'
csv\t'Comma-separated values with a header'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l out -d 'Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if missing' -r -F
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -l quick -d 'Run a small part in some seconds, to see that everything runs; not a measurement'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand budget" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand compare" -l format -d 'Output format' -r -f -a "text\t'Changes, as text'
json\t'One JSON object with every number'"
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand compare" -l fail-on-worse -d 'Exit with status 1 when more numbers changed for the worse than chance explains: more than half of the changes expected by chance, rounded up, plus two. Numbers with only one value per run are ignored'
complete -c cdcr-bench -n "__fish_cdcr_bench_using_subcommand compare" -s h -l help -d 'Print help (see more with \'--help\')'
