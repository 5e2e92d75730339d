//! What was learned and comes with the program for beliefs: boosted trees, the network that completes shapes and the one that looks at feet. Who forms a belief does so with its own,
//! whatever weights inference serves, and so a result that rests on a belief says which they were.

use std::sync::LazyLock;

use repose_networks::{completion, digest::digest, feet};

use crate::completion::network;
use crate::{back, bearing, cut, farther, foot};

/// Every part by name, as its file has it.
pub fn parts() -> [(&'static str, &'static [u8]); 7] {
    [
        ("back", back::FILE.as_bytes()),
        ("bearing", bearing::FILE.as_bytes()),
        ("completion", completion::FILE),
        ("cut", cut::FILE.as_bytes()),
        ("farther", farther::FILE.as_bytes()),
        ("feet", feet::FILE),
        ("foot", foot::FILE.as_bytes()),
    ]
}

/// BLAKE3 of everything learned that a result rests on, hexadecimal: these parts, and the weights of this hash; empty where none were asked.
pub fn models_hash(weights_hash: &str) -> String {
    static PARTS: LazyLock<String> = LazyLock::new(|| digest(parts()));
    together(&PARTS, weights_hash)
}

fn together(parts_hash: &str, weights_hash: &str) -> String {
    digest([("beliefs", parts_hash.as_bytes()), ("weights", weights_hash.as_bytes())])
}

/// The kernel on which this process completes shapes and looks at feet.
pub fn kernel_id() -> &'static str {
    network().kernel_id()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_of_any_part_and_other_weights_give_another_hash() {
        let own = models_hash("aa");
        assert_eq!(together(&digest(parts()), "aa"), own);
        for changed in 0..parts().len() {
            let mut files = parts().map(|(name, file)| (name, file.to_vec()));
            let (name, file) = &mut files[changed];
            file[100] ^= 1;
            let name = *name;
            let hash = digest(files.iter().map(|(name, file)| (*name, file.as_slice())));
            assert_ne!(together(&hash, "aa"), own, "{name}");
        }
        assert_ne!(models_hash("ab"), own);
        assert_eq!(models_hash("").len(), own.len(), "without weights there is a hash, too");
    }
}
