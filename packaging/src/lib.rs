//! Manual pages and shell completions, generated from the command lines.
//!
//! They are committed below `packaging/generated`, so that `cargo deb` finds them after a fresh clone. Each
//! program has a test that calls [`check`]: it fails when a page differs from the command line. When
//! `CDCR_GENERATE` is set, it writes all pages instead:
//!
//! ```sh
//! CDCR_GENERATE=1 cargo test --workspace the_manual
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Command;
use clap_complete::env::Shells;
use clap_complete::{Generator, Shell};
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};

/// Folder of the committed files.
const GENERATED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/generated");

/// Manual pages and completions of one program, by their paths below `generated`.
pub type Files = BTreeMap<PathBuf, Vec<u8>>;

/// Compares the committed files of a program with its command line, or writes them when `CDCR_GENERATE` is
/// set. `section` is the section of the manual: 1 for user commands, 8 for daemons. `answers` is the
/// environment variable with which a program itself answers completion requests of shells, and how.
///
/// # Errors
/// When a file is missing or differs, or belongs to a removed command.
pub fn check(command: &Command, section: &str, answers: Option<(&str, &Shells)>) -> Result<()> {
    let files = generate(command, section, answers)?;
    let folder = Path::new(GENERATED);
    if std::env::var_os("CDCR_GENERATE").is_some() {
        return write(folder, command.get_name(), &files);
    }
    compare(folder, command.get_name(), &files)
}

/// The files of a program.
///
/// # Errors
/// When a page cannot be rendered.
pub fn generate(
    command: &Command,
    section: &str,
    answers: Option<(&str, &Shells)>,
) -> Result<Files> {
    let name = command.get_name().to_owned();
    // `help` would get a page for each command.
    let mut command = command.clone().disable_help_subcommand(true);
    command.build();
    let mut files = Files::new();
    add_pages(&mut files, &command, section)?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        let mut text = Vec::new();
        match answers {
            None => clap_complete::generate(shell, &mut command, &name, &mut text),
            Some((variable, shells)) => shells
                .completer(&shell.to_string())
                .context("a shell that the program does not answer")?
                .write_registration(variable, &name, &name, &name, &mut text)?,
        }
        files.insert(Path::new("completions").join(shell.file_name(&name)), text);
    }
    Ok(files)
}

/// The page of a command, and the pages of its subcommands.
fn add_pages(files: &mut Files, command: &Command, section: &str) -> io::Result<()> {
    for below in command.get_subcommands().filter(|c| !c.is_hide_set()) {
        add_pages(files, below, section)?;
    }
    let man = Man::new(command.clone()).section(section).manual("cdcr");
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    if command
        .get_arguments()
        .any(|argument| !argument.is_hide_set())
    {
        man.render_options_section(&mut page)?;
    }
    if command.has_subcommands() {
        man.render_subcommands_section(&mut page)?;
    }
    add_examples(&mut page, command)?;
    files.insert(Path::new("man").join(man.get_filename()), page);
    Ok(())
}

/// The text after the help, line by line and unchanged.
fn add_examples(page: &mut Vec<u8>, command: &Command) -> io::Result<()> {
    let Some(text) = command.get_after_long_help().or(command.get_after_help()) else {
        return Ok(());
    };
    let mut roff = Roff::new();
    roff.control("SH", ["EXAMPLES"]).control("nf", []);
    for line in text.to_string().lines() {
        roff.text([roman(line)]);
    }
    roff.control("fi", []);
    roff.to_writer(page)
}

fn compare(folder: &Path, program: &str, files: &Files) -> Result<()> {
    let remedy =
        "run `CDCR_GENERATE=1 cargo test --workspace the_manual` and commit what it writes";
    for (path, text) in files {
        let path = folder.join(path);
        let committed = fs::read(&path);
        let committed = committed.with_context(|| format!("{}; {remedy}", path.display()))?;
        if committed != *text {
            bail!(
                "{} is not what the command line says; {remedy}",
                path.display()
            );
        }
    }
    for path in pages_of(folder, program)? {
        if !files.contains_key(path.strip_prefix(folder)?) {
            bail!("{} is about no command; {remedy}", path.display());
        }
    }
    Ok(())
}

fn write(folder: &Path, program: &str, files: &Files) -> Result<()> {
    for path in pages_of(folder, program)? {
        fs::remove_file(path)?;
    }
    for (path, text) in files {
        let path = folder.join(path);
        fs::create_dir_all(path.parent().unwrap_or(folder))?;
        fs::write(&path, text).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// The committed pages of a program and of its commands.
fn pages_of(folder: &Path, program: &str) -> Result<Vec<PathBuf>> {
    let Ok(entries) = fs::read_dir(folder.join("man")) else {
        return Ok(Vec::new());
    };
    let mut pages = Vec::new();
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let rest = name.strip_prefix(program);
        if rest.is_some_and(|rest| rest.starts_with(['.', '-'])) {
            pages.push(entry.path());
        }
    }
    Ok(pages)
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;
    use clap::Arg;

    use super::*;

    fn program(option: &'static str) -> Command {
        Command::new("prog")
            .version("1.2.3")
            .about("Does a thing")
            .arg(Arg::new("option").long(option))
            .subcommand(
                Command::new("go")
                    .about("Goes")
                    .after_help("Examples:\n  prog go\n  prog go  # twice"),
            )
            .subcommand(Command::new("secret").hide(true))
    }

    #[test]
    fn a_page_for_each_command_and_a_completion_for_each_shell() {
        let files = generate(&program("fast"), "8", None).unwrap();
        let names: Vec<_> = files.keys().map(|path| path.to_str().unwrap()).collect();
        assert_eq!(
            names,
            [
                "completions/_prog",
                "completions/prog.bash",
                "completions/prog.fish",
                "man/prog-go.8",
                "man/prog.8",
            ]
        );
        let page = String::from_utf8_lossy(&files[Path::new("man/prog-go.8")]).into_owned();
        assert!(page.contains(".nf\n"), "{page}");
        assert!(page.contains("prog go  # twice\n"), "{page}");
    }

    #[test]
    fn what_is_stale_missing_or_left_over_is_found() {
        let folder = Scratch::temporary().unwrap();
        let folder = folder.path();
        let files = generate(&program("fast"), "1", None).unwrap();
        let text = |result: Result<()>| format!("{:#}", result.unwrap_err());
        assert!(text(compare(folder, "prog", &files)).contains("CDCR_GENERATE"));
        write(folder, "prog", &files).unwrap();
        compare(folder, "prog", &files).unwrap();
        let slow = generate(&program("slow"), "1", None).unwrap();
        assert!(text(compare(folder, "prog", &slow)).contains("not what"));
        fs::write(folder.join("man/prog-gone.1"), "old").unwrap();
        fs::write(folder.join("man/progress.1"), "of another program").unwrap();
        assert!(text(compare(folder, "prog", &files)).contains("prog-gone.1"));
        write(folder, "prog", &slow).unwrap();
        compare(folder, "prog", &slow).unwrap();
        assert!(!folder.join("man/prog-gone.1").exists());
        assert!(folder.join("man/progress.1").exists());
    }
}
