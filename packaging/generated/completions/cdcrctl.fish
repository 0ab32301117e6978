complete --keep-order --exclusive --command cdcrctl --arguments "(CDCRCTL_COMPLETE=fish cdcrctl -- (commandline --current-process --tokenize --cut-at-cursor) (commandline --current-token))"
