//! Paths in JSON, for `#[serde(with = "path_text")]`: as text, or as bytes where a name is no Unicode,
//! so that every path that the system knows can be written and found again.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::{Path, PathBuf};

/// A path as stored.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum StoredPath {
    /// A path in Unicode.
    Text(String),
    /// Any other path of Unix, byte by byte; the text is for readers alone.
    Bytes { text: String, bytes: Vec<u8> },
}

impl StoredPath {
    fn new(path: &Path) -> Self {
        match path.to_str() {
            Some(text) => Self::Text(text.to_owned()),
            None => {
                let bytes = path.as_os_str().as_encoded_bytes().to_vec();
                Self::Bytes { text: path.to_string_lossy().into_owned(), bytes }
            }
        }
    }

    fn into_path(self) -> PathBuf {
        match self {
            Self::Text(text) => text.into(),
            #[cfg(unix)]
            Self::Bytes { bytes, .. } => {
                let name: std::ffi::OsString = std::os::unix::ffi::OsStringExt::from_vec(bytes);
                name.into()
            }
            // The bytes are those of another kind of system.
            #[cfg(not(unix))]
            Self::Bytes { text, .. } => text.into(),
        }
    }
}

/// Writes a path.
pub fn serialize<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    StoredPath::new(path).serialize(to)
}

/// Reads a path.
pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<PathBuf, D::Error> {
    StoredPath::deserialize(from).map(StoredPath::into_path)
}

/// Paths that may be missing.
pub mod optional {
    use super::{Deserialize, Deserializer, PathBuf, Serialize, Serializer, StoredPath};

    /// Writes a path or null.
    pub fn serialize<S: Serializer>(path: &Option<PathBuf>, to: S) -> Result<S::Ok, S::Error> {
        path.as_deref().map(StoredPath::new).serialize(to)
    }

    /// Reads a path or null.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<PathBuf>, D::Error> {
        let stored = Option::<StoredPath>::deserialize(from)?;
        Ok(stored.map(StoredPath::into_path))
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;

    #[derive(Serialize, Deserialize)]
    struct Holder {
        #[serde(with = "super")]
        path: PathBuf,
        #[serde(with = "super::optional", default)]
        other: Option<PathBuf>,
    }

    #[test]
    fn every_path_survives() {
        let odd: PathBuf = OsString::from_vec(b"/data/caf\xe9 \"1\"".to_vec()).into();
        for (path, other) in [
            (PathBuf::from("/data/room"), None),
            ("/data/Grüße\n".into(), Some("b".into())),
            (odd.clone(), Some(odd)),
        ] {
            let holder = Holder { path: path.clone(), other: other.clone() };
            let text = serde_json::to_string(&holder).expect("JSON");
            let back: Holder = serde_json::from_str(&text).expect(&text);
            assert_eq!((back.path, back.other), (path, other));
        }
        let plain: Holder = serde_json::from_str(r#"{"path": "a"}"#).expect("an earlier file");
        assert_eq!((plain.path, plain.other), ("a".into(), None));
    }
}
