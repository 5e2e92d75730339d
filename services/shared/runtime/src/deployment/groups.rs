//! Whom a deployment's secrets are shared with: the group that its units run as.
//!
//! Whoever writes a deployment to `/etc` is root, and its secrets are its owner's alone; the units are not run by root.

use std::path::Path;

use repose_proto::CallError;

use super::writer::{Failed, WrittenFiles};

/// Where the groups of a machine are.
const GROUPS: &str = "/etc/group";

/// A group of this machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    id: u32,
}

impl Group {
    /// The group of a name, or of a number.
    ///
    /// # Errors
    /// `invalid_argument` on `group` where this machine has none of that name.
    pub fn named(name: &str) -> Result<Self, CallError> {
        if let Ok(id) = name.parse() {
            return Ok(Self { id });
        }
        let groups = std::fs::read_to_string(GROUPS).map_err(|e| CallError::invalid("group", format!("{GROUPS}: {e}")))?;
        let unknown =
            || CallError::invalid("group", format!("{GROUPS} has no group {name:?}; a group from elsewhere is named by its number"));
        in_lines(&groups, name).map(|id| Self { id }).ok_or_else(unknown)
    }

    /// Lets the group read what was written to `deployment` and is not for everybody, but for the authority: whoever has its key makes users.
    ///
    /// # Errors
    /// The file whose group could not be set: it takes root, or an owner who is in the group.
    pub fn may_read(self, written: &WrittenFiles, deployment: &Path) -> Result<(), Failed> {
        let authority = deployment.join("authority");
        for file in written.files.iter().chain(&written.kept).filter(|file| !file.starts_with(&authority)) {
            self.share(file, 0o004, 0o040)?;
            for folder in file.ancestors().skip(1).take_while(|folder| folder.starts_with(deployment)) {
                self.share(folder, 0o001, 0o050)?;
            }
        }
        Ok(())
    }

    /// Adds the `group` bits to the mode of a path, unless `others` have theirs anyway.
    #[cfg(unix)]
    fn share(self, path: &Path, others: u32, group: u32) -> Result<(), Failed> {
        use std::os::unix::fs::PermissionsExt as _;
        let fail = |e: std::io::Error| Failed::new(path, e);
        let mut permissions = std::fs::metadata(path).map_err(fail)?.permissions();
        if permissions.mode() & others != 0 {
            return Ok(());
        }
        // The group first: the one before it is not to read what the new one may.
        std::os::unix::fs::chown(path, None, Some(self.id)).map_err(fail)?;
        permissions.set_mode(permissions.mode() & 0o7777 | group);
        std::fs::set_permissions(path, permissions).map_err(fail)
    }

    #[cfg(not(unix))]
    fn share(self, path: &Path, _others: u32, _group: u32) -> Result<(), Failed> {
        Err(Failed::new(path, "this system has no groups of files"))
    }
}

/// A group's number in lines of `name:password:number:members`.
fn in_lines(groups: &str, name: &str) -> Option<u32> {
    let mut found = groups.lines().map(|line| line.split(':')).filter_map(|mut fields| Some((fields.next()?, fields.nth(1)?)));
    found.find(|(known, _)| *known == name).and_then(|(_, id)| id.parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_is_found_by_its_name_or_number_and_an_unknown_one_is_refused() {
        let lines = "root:x:0:\nrepose-old:x:7:\nrepose:x:998:anna,bert\n";
        assert_eq!((in_lines(lines, "repose"), in_lines(lines, "anna"), in_lines(lines, "")), (Some(998), None, None));
        assert_eq!(Group::named("998"), Ok(Group { id: 998 }));
        assert!(Group::named("no such group").is_err_and(|e| e.field.as_deref() == Some("group")));
    }
}
