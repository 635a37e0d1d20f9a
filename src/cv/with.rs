//! What OpenCV does here, with the feature `opencv`.

/// What `--version` says of OpenCV.
pub fn built_in() -> String {
    let version = opencv::core::get_version_string().unwrap_or_default();
    format!("opencv {version}")
}
