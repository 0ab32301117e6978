use std::ffi::OsString;
use std::io::{Result, Write};
use std::path::Path;

use clap::Command;
use clap_complete::env::{EnvCompleter, Zsh as OfClap};

/// Zsh, with a script that adds no space after `KEY=`, and that may also be in `$fpath`.
#[derive(Debug)]
pub(super) struct Zsh;

/// The place in clap's script that offers words other than folders.
const OFFER: &str = "        [[ -n $other ]] && _describe -V 'values' other\n";
/// Offers keys first, without a space.
const OFFER_KEYS: &str = r#"        local -a keys=("${(@M)other:#*=}")
        [[ -n $keys ]] && _describe -V 'values' keys -S ''
        other=("${(@)other:#*=}")
"#;

impl EnvCompleter for Zsh {
    fn name(&self) -> &'static str {
        OfClap.name()
    }

    fn is(&self, name: &str) -> bool {
        OfClap.is(name)
    }

    fn write_registration(
        &self,
        variable: &str,
        name: &str,
        program: &str,
        completer: &str,
        out: &mut dyn Write,
    ) -> Result<()> {
        let mut script = Vec::new();
        OfClap.write_registration(variable, name, program, completer, &mut script)?;
        let script = String::from_utf8_lossy(&script);
        let script = script.replace(OFFER, &format!("{OFFER_KEYS}{OFFER}"));
        write!(out, "{script}")?;
        // A script in `$fpath` is read at the first completion of the program.
        let call = format!("_clap_dynamic_completer_{}", name.replace('-', "_"));
        writeln!(out, "[[ $funcstack[1] = _{name} ]] && {call}")
    }

    fn write_complete(
        &self,
        command: &mut Command,
        arguments: Vec<OsString>,
        folder: Option<&Path>,
        out: &mut dyn Write,
    ) -> Result<()> {
        OfClap.write_complete(command, arguments, folder, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_of_clap_is_what_it_was_made_for() {
        let mut script = Vec::new();
        Zsh.write_registration("V", "cdcrctl", "cdcrctl", "cdcrctl", &mut script)
            .expect("written");
        let script = String::from_utf8(script).expect("UTF-8");
        assert!(script.contains(&format!("{OFFER_KEYS}{OFFER}")), "{script}");
    }
}
