# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_cdcrctl_global_optspecs
    string join \n prefix= root= robot= h/help V/version
end

function __fish_cdcrctl_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_cdcrctl_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_cdcrctl_using_subcommand
    set -l cmd (__fish_cdcrctl_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -s V -l version -d 'Print version'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "demo" -d 'Run the paper\'s spiral with a daemon of its own and report error, timing and what limits it'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "ref" -d 'Feed a reference to the daemon, ahead of time'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "track" -d 'Ask the daemon to follow the reference that a client feeds; waits for one at most 2 s'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "hold" -d 'Stop following and keep the position'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "home" -d 'Move to the straight configuration'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "stop" -d 'Stop the robot and latch; only a reset lets it move again'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "reset" -d 'Leave stopped or faulted'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "status" -d 'Show the newest snapshot: mode, counters, latencies, robot, settings'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "incidents" -d 'Show the last bad cycles: late starts, deadline misses, skipped periods, beginnings of faults'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "settings" -d 'Show or change the settings of the solver while the daemon runs'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "echo" -d 'Print messages as they pass'
complete -c cdcrctl -n "__fish_cdcrctl_needs_command" -f -a "obstacle" -d 'Add or remove obstacles that the body of the robot keeps away from'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l sections -d 'Sections of the robot: 1, 2 or 3, as in the paper' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l duration -d 'How long the spiral lasts, 0.1 s to 20 s; the paper\'s lasts 4.97 s' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l format -d 'How to print the report' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l out -d 'Write telemetry.csv, path.svg, shape.svg, error.svg and timing.svg into this folder' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand demo" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -f -a "spiral" -d 'The paper\'s spiral, Eq. 8'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -f -a "line" -d 'The paper\'s line, Eq. 9'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -f -a "circle" -d 'The paper\'s circle, §4.3'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and not __fish_seen_subcommand_from spiral line circle file" -f -a "file" -d 'A CSV file with the columns `t_s,x_m,y_m,z_m[,qx,qy,qz,qw]`'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l start -d 'First value of the parameter t, in degrees [default: 5]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l sections -d 'Sections that the curve is made for [default: those of the daemon\'s robot]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l duration -d 'How long it lasts [default: as in the paper]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l interpolation -d 'How the daemon interpolates between the points' -r -f -a "linear\t'Straight lines'
cubic\t'A smooth cubic curve'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l max-error -d 'Largest error of the tip: fail when it is larger in any cycle, or nothing was tracked; with its unit, 2mm or 0.002m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l lead -d 'How long after now the reference begins' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l step -d 'Time between two points of a curve' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -l track -d 'Ask for tracking as soon as the first chunk is in'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from spiral" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l start -d 'Where it begins, in m [default: tip of the straight robot]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l velocity -d 'How fast it goes, in m/s' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l axis -d 'Direction that the tip axis keeps, for example 0,0,1 as in the paper [default: any]. The daemon turns the tip that way, too, as much as its orientation weight asks for' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l sections -d 'Sections that the curve is made for [default: those of the daemon\'s robot]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l duration -d 'How long it lasts [default: as in the paper]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l interpolation -d 'How the daemon interpolates between the points' -r -f -a "linear\t'Straight lines'
cubic\t'A smooth cubic curve'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l max-error -d 'Largest error of the tip: fail when it is larger in any cycle, or nothing was tracked; with its unit, 2mm or 0.002m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l lead -d 'How long after now the reference begins' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l step -d 'Time between two points of a curve' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -l track -d 'Ask for tracking as soon as the first chunk is in'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from line" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l radius -d 'Radius in m [default: 0.16986 for a last section of 0.3 m]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l height -d 'Height in m [default: 0.22137 above a last section of 0.3 m]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l rate -d 'How fast it goes round, in rad/s; negative: clockwise' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l sections -d 'Sections that the curve is made for [default: those of the daemon\'s robot]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l duration -d 'How long it lasts [default: as in the paper]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l interpolation -d 'How the daemon interpolates between the points' -r -f -a "linear\t'Straight lines'
cubic\t'A smooth cubic curve'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l max-error -d 'Largest error of the tip: fail when it is larger in any cycle, or nothing was tracked; with its unit, 2mm or 0.002m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l lead -d 'How long after now the reference begins' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l step -d 'Time between two points of a curve' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -l track -d 'Ask for tracking as soon as the first chunk is in'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from circle" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l interpolation -d 'How the daemon interpolates between the points' -r -f -a "linear\t'Straight lines'
cubic\t'A smooth cubic curve'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l max-error -d 'Largest error of the tip: fail when it is larger in any cycle, or nothing was tracked; with its unit, 2mm or 0.002m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l lead -d 'How long after now the reference begins' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l step -d 'Time between two points of a curve' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -l track -d 'Ask for tracking as soon as the first chunk is in'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand ref; and __fish_seen_subcommand_from file" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand track" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand track" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand track" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand track" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand hold" -l wait -d 'Wait until it is done and the robot rests; fail when it becomes something else, or takes longer [default: 60s]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand hold" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand hold" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand hold" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand hold" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand home" -l wait -d 'Wait until it is done and the robot rests; fail when it becomes something else, or takes longer [default: 60s]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand home" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand home" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand home" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand home" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand stop" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand stop" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand stop" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand stop" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand reset" -l wait -d 'Wait until it is done and the robot rests; fail when it becomes something else, or takes longer [default: 60s]' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand reset" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand reset" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand reset" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand reset" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -l format -d 'How to print' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -l watch -d 'Show it anew every second, until interrupted'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -l reset-statistics -d 'Begin the statistics anew and show nothing; a stopped robot stays stopped (that is cdcrctl reset)'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand status" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -l format -d 'One line for each (text), or each whole as one JSON object on a line' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -l count -d 'Only so many of those that are kept, the newest' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -l follow -d 'Go on with each new one, until interrupted'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand incidents" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -l format -d 'How to print' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -f -a "show" -d 'Show them with their ranges, as the newest cycle used them'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -f -a "set" -d 'Change some of them, all at once or not at all, until the daemon ends'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and not __fish_seen_subcommand_from show set save" -f -a "save" -d 'Write the settings that are in force into a configuration, which keeps its comments and all other keys'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from show" -l format -d 'How to print' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from show" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from show" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from show" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from show" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from set" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from set" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from set" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from set" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from save" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from save" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from save" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand settings; and __fish_seen_subcommand_from save" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -l format -d 'One line for each message (text), or one JSON object on each line' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -l count -d 'End after this many messages' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -l rate -d 'Print at most this many messages a second and leave out the rest' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand echo" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -f -a "add" -d 'Add a sphere, or with --to a capsule; a known id is replaced'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -f -a "list" -d 'Show the obstacles that the newest cycle knew, where they were then'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -f -a "remove" -d 'Remove obstacles by their ids; one that is not known changes nothing'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and not __fish_seen_subcommand_from add list remove clear" -f -a "clear" -d 'Remove all obstacles'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l id -d 'Its id, chosen by you, unique among all clients' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l at -d 'Centre of the sphere, or first end of the capsule, in m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l to -d 'Second end of the capsule\'s axis, in m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l radius -d 'Radius in m' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l velocity -d 'Velocity in m/s: the daemon moves it on from now' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l lifetime -d 'How long it stays known [default: until removed]. Refused where the daemon watches those who send obstacles with lifetimes' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -l far -d 'The numbers are in m, however far away that is'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from add" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from list" -l format -d 'How to print' -r -f -a "text\t'For people'
json\t'For programs'"
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from list" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from list" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from list" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from list" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from remove" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from remove" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from remove" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from remove" -s h -l help -d 'Print help'
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from clear" -l prefix -d 'Prefix of the daemon\'s shared-memory files' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from clear" -l root -d 'Root path of the daemon\'s files [default: /dev/shm/cdcr-UID]' -r -F
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from clear" -l robot -d 'Name of the robot' -r
complete -c cdcrctl -n "__fish_cdcrctl_using_subcommand obstacle; and __fish_seen_subcommand_from clear" -s h -l help -d 'Print help'
