use std::path::PathBuf;

use cdcr_shared_types::{DEFAULT_PREFIX, Location, LocationError};

use super::Origins;
use super::error::Result;

table! {
    /// Location of daemon and clients in shared memory.
    pub struct TransportConfig {
        /// Prefix of the shared-memory files: 1 to 40 letters, digits, '-' and '_'.
        prefix: String = DEFAULT_PREFIX.to_owned();
        /// Root folder in memory (tmpfs), absolute, at most 100 characters; "": /dev/shm/cdcr-<user id>.
        root: String = String::new();
        /// Group whose members also have access: its name in /etc/group or its number; "": none. The root folder must be in a folder
        /// owned by root, such as /run, so that no other user can replace it.
        group: String = String::new();
    }
}

/// The system's list of groups.
const GROUPS: &str = "/etc/group";

impl TransportConfig {
    /// Number of the group with access.
    pub(super) fn group_id(&self, origins: &Origins) -> Result<Option<u32>> {
        if self.group.is_empty() {
            return Ok(None);
        }
        let groups = std::fs::read_to_string(GROUPS).unwrap_or_default();
        let named = || number_of(&self.group, &groups);
        let number = self.group.parse().ok().or_else(named);
        number.map(Some).ok_or_else(|| {
            let message = format!(
                "unknown group {:?} in {GROUPS}: create it (groupadd), or use the number of a group from another database (getent group)",
                self.group
            );
            origins.error(&["transport.group"], message)
        })
    }

    /// The location given by prefix and root.
    pub(super) fn location(&self, origins: &Origins) -> Result<Location> {
        let root = match &*self.root {
            "" => Location::default_root(),
            root => PathBuf::from(root),
        };
        Location::new(&self.prefix, &root).map_err(|error| {
            let key = match error {
                LocationError::Prefix(_) => "transport.prefix",
                LocationError::Root(_) => "transport.root",
            };
            origins.error(&[key], error)
        })
    }
}

/// The number of a group in a text like `/etc/group`, see `group(5)`.
fn number_of(group: &str, groups: &str) -> Option<u32> {
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let number = (fields.next() == Some(group)).then(|| fields.nth(1))??;
        number.parse().ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_is_found_by_its_whole_name_and_may_be_a_number() {
        let groups = "root:x:0:\nrobots:x:7:a\n# robot\nrobot:x:1001:anna,ben\nbroken:x\n";
        assert_eq!(number_of("robot", groups), Some(1001));
        let config: TransportConfig = toml::from_str("group = '1001'").unwrap();
        assert_eq!(config.group_id(&Origins::default()).unwrap(), Some(1001));
        for missing in ["robo", "", "x", "broken", "anna"] {
            assert_eq!(number_of(missing, groups), None, "{missing}");
        }
    }
}
