//! The same functions without the feature `opencv`: each says how to get it.

/// What `--version` says of OpenCV.
pub fn built_in() -> String {
    "no opencv".to_owned()
}
