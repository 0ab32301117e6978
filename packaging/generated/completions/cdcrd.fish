# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_cdcrd_global_optspecs
    string join \n h/help V/version
end

function __fish_cdcrd_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_cdcrd_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_cdcrd_using_subcommand
    set -l cmd (__fish_cdcrd_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c cdcrd -n "__fish_cdcrd_needs_command" -s h -l help -d 'Print help'
complete -c cdcrd -n "__fish_cdcrd_needs_command" -s V -l version -d 'Print version'
complete -c cdcrd -n "__fish_cdcrd_needs_command" -f -a "run" -d 'Run the control loop until SIGINT or SIGTERM'
complete -c cdcrd -n "__fish_cdcrd_needs_command" -f -a "bare" -d 'Run the real-time loop without work: the baseline of this machine'
complete -c cdcrd -n "__fish_cdcrd_needs_command" -f -a "check" -d 'Check a configuration and print a summary'
complete -c cdcrd -n "__fish_cdcrd_needs_command" -f -a "doctor" -d 'Check this machine for causes of delay in a real-time loop, and print remedies'
complete -c cdcrd -n "__fish_cdcrd_needs_command" -f -a "config" -d 'Print or explain the configuration'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l config -d 'Configuration file (TOML) [env: CDCR_CONFIG]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l tuning -d 'Set the keys that trade precision against smoothness and speed, as measured on a well-built robot' -r -f -a "precise\t'Smallest tip error that the sensors allow'
smooth\t'Rate changes reduced to a fifth'
fast\t'Deviations from the commands corrected five times as fast'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l set -d 'Set one key, as TOML; repeatable [env: as CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l robot -d 'Name of the robot in the service names: robot.name [env: CDCR_ROBOT]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l prefix -d 'Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l root -d 'Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -l end-with-parent -d 'End when the parent process, which has this id, ends, however it ends' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand run" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l config -d 'Configuration file (TOML) [env: CDCR_CONFIG]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l tuning -d 'Set the keys that trade precision against smoothness and speed, as measured on a well-built robot' -r -f -a "precise\t'Smallest tip error that the sensors allow'
smooth\t'Rate changes reduced to a fifth'
fast\t'Deviations from the commands corrected five times as fast'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l set -d 'Set one key, as TOML; repeatable [env: as CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l robot -d 'Name of the robot in the service names: robot.name [env: CDCR_ROBOT]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l prefix -d 'Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l root -d 'Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l duration -d 'Duration: 1 to 10 million periods' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l format -d 'Output format' -r -f -a "text\t'Table'
csv\t'One line per cycle'
json\t'The numbers of the table as one JSON object'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -l end-with-parent -d 'End when the parent process, which has this id, ends, however it ends' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand bare" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -l config -d 'Configuration file (TOML) [env: CDCR_CONFIG]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -l tuning -d 'Set the keys that trade precision against smoothness and speed, as measured on a well-built robot' -r -f -a "precise\t'Smallest tip error that the sensors allow'
smooth\t'Rate changes reduced to a fifth'
fast\t'Deviations from the commands corrected five times as fast'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -l set -d 'Set one key, as TOML; repeatable [env: as CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -l robot -d 'Name of the robot in the service names: robot.name [env: CDCR_ROBOT]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -l prefix -d 'Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -l root -d 'Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand check" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l config -d 'Configuration file (TOML) [env: CDCR_CONFIG]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l tuning -d 'Set the keys that trade precision against smoothness and speed, as measured on a well-built robot' -r -f -a "precise\t'Smallest tip error that the sensors allow'
smooth\t'Rate changes reduced to a fifth'
fast\t'Deviations from the commands corrected five times as fast'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l set -d 'Set one key, as TOML; repeatable [env: as CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l robot -d 'Name of the robot in the service names: robot.name [env: CDCR_ROBOT]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l prefix -d 'Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l root -d 'Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -l format -d 'Output format' -r -f -a "text\t'One line per finding, with reason and remedy if it is not ok'
json\t'One JSON object'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand doctor" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and not __fish_seen_subcommand_from default schema explain" -s h -l help -d 'Print help'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and not __fish_seen_subcommand_from default schema explain" -f -a "default" -d 'Print the default configuration with a description of every key'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and not __fish_seen_subcommand_from default schema explain" -f -a "schema" -d 'Print the JSON schema of the configuration, for editors and programs'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and not __fish_seen_subcommand_from default schema explain" -f -a "explain" -d 'Explain a key or a table: type, range, default, current value and its source'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from default" -s h -l help -d 'Print help'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from schema" -s h -l help -d 'Print help'
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -l config -d 'Configuration file (TOML) [env: CDCR_CONFIG]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -l tuning -d 'Set the keys that trade precision against smoothness and speed, as measured on a well-built robot' -r -f -a "precise\t'Smallest tip error that the sensors allow'
smooth\t'Rate changes reduced to a fifth'
fast\t'Deviations from the commands corrected five times as fast'"
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -l set -d 'Set one key, as TOML; repeatable [env: as CDCR_CYCLE_PERIOD_MS=2 for cycle.period_ms]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -l robot -d 'Name of the robot in the service names: robot.name [env: CDCR_ROBOT]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -l prefix -d 'Prefix of the shared-memory files: transport.prefix [env: CDCR_PREFIX]' -r
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -l root -d 'Root folder of the shared-memory services: transport.root [env: CDCR_ROOT]' -r -F
complete -c cdcrd -n "__fish_cdcrd_using_subcommand config; and __fish_seen_subcommand_from explain" -s h -l help -d 'Print help (see more with \'--help\')'
