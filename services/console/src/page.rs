//! The page's files, inside the program.

use std::sync::LazyLock;

/// A file of the page.
pub struct File {
    /// Its path in URLs.
    pub path: &'static str,
    /// Its content.
    pub bytes: &'static [u8],
    media_type: &'static str,
    hash: LazyLock<String>,
}

impl File {
    /// What it is, for `Content-Type`.
    pub fn media_type(&self) -> &'static str {
        self.media_type
    }

    /// The hash of its content, for `ETag`.
    pub fn hash(&self) -> &str {
        &self.hash
    }
}

macro_rules! files {
    ($($path:literal: $media_type:literal),+ $(,)?) => {
        [$(File {
            path: concat!("/", $path),
            bytes: include_bytes!(concat!("../page/", $path)),
            media_type: $media_type,
            hash: LazyLock::new(|| blake3::hash(include_bytes!(concat!("../page/", $path))).to_hex()[..32].to_owned()),
        }),+]
    };
}

/// The page itself. `NONCE` in it stands for a number that every answer has its own of: only scripts that bear it run.
pub const INDEX: &str = include_str!("../page/index.html");

/// Everything that the page loads.
pub static FILES: [File; 28] = files! {
    "css/page.css": "text/css; charset=utf-8",
    "icon.svg": "image/svg+xml",
    "js/activity.js": "text/javascript; charset=utf-8",
    "js/age.js": "text/javascript; charset=utf-8",
    "js/arm.js": "text/javascript; charset=utf-8",
    "js/arrangement.js": "text/javascript; charset=utf-8",
    "js/bulk.js": "text/javascript; charset=utf-8",
    "js/connection.js": "text/javascript; charset=utf-8",
    "js/element.js": "text/javascript; charset=utf-8",
    "js/goal.js": "text/javascript; charset=utf-8",
    "js/keys.js": "text/javascript; charset=utf-8",
    "js/main.js": "text/javascript; charset=utf-8",
    "js/notice.js": "text/javascript; charset=utf-8",
    "js/picture.js": "text/javascript; charset=utf-8",
    "js/placements.js": "text/javascript; charset=utf-8",
    "js/scene.js": "text/javascript; charset=utf-8",
    "js/seen.js": "text/javascript; charset=utf-8",
    "js/sign_in.js": "text/javascript; charset=utf-8",
    "js/stops.js": "text/javascript; charset=utf-8",
    "js/stored.js": "text/javascript; charset=utf-8",
    "js/system.js": "text/javascript; charset=utf-8",
    "js/theme.js": "text/javascript; charset=utf-8",
    "js/tip.js": "text/javascript; charset=utf-8",
    "js/words.js": "text/javascript; charset=utf-8",
    "vendor/three/LICENSE": "text/plain; charset=utf-8",
    "vendor/three/OrbitControls.js": "text/javascript; charset=utf-8",
    "vendor/three/three.core.min.js": "text/javascript; charset=utf-8",
    "vendor/three/three.module.min.js": "text/javascript; charset=utf-8",
};

/// The hash of the whole page.
pub fn page_hash() -> &'static str {
    static HASH: LazyLock<String> = LazyLock::new(|| {
        let mut hasher = blake3::Hasher::new();
        hasher.update(INDEX.as_bytes());
        for file in &FILES {
            hasher.update(file.hash().as_bytes());
        }
        hasher.finalize().to_hex()[..32].to_owned()
    });
    &HASH
}

/// The file at a path.
pub fn file(path: &str) -> Option<&'static File> {
    FILES.iter().find(|f| f.path == path)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn every_reason_for_which_candidates_are_rejected_has_words_and_a_color() {
        let words = include_str!("../page/js/words.js");
        let table = |name: &str| {
            let from = words.find(&format!("export const {name} = {{")).expect("a table of that name");
            words[from..].split_once("};").expect("its end").0
        };
        for reason in repose_proto::place::Rejection::ALL {
            let reason = serde_json::to_value(reason).expect("a name").as_str().expect("a name").to_owned();
            for name in ["REJECTIONS", "REJECTION_COLORS"] {
                assert!(table(name).contains(&format!(" {reason}: ")), "{name} lacks {reason}");
            }
        }
    }

    fn on_disk(folder: &Path, found: &mut Vec<String>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            match path.is_dir() {
                true => on_disk(&path, found),
                false => found.push(path.strip_prefix(root()).expect("below the page").display().to_string()),
            }
        }
    }

    fn root() -> &'static Path {
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/page"))
    }

    #[test]
    fn every_file_of_the_page_is_in_the_program_and_nothing_else() {
        let mut found = Vec::new();
        on_disk(root(), &mut found);
        found.retain(|path| path != "index.html");
        found.sort();
        assert_eq!(found, FILES.iter().map(|f| f.path[1..].to_owned()).collect::<Vec<_>>());
    }

    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        let own = FILES.iter().filter(|f| !f.path.starts_with("/vendor"));
        for text in own.map(|f| String::from_utf8_lossy(f.bytes).into_owned()).chain([INDEX.to_owned()]) {
            let foreign = text.lines().find(|l| (l.contains("https://") || l.contains("http://")) && !l.contains("www.w3.org"));
            assert_eq!(foreign, None);
        }
    }
}
