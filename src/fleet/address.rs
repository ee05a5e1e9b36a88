//! Addresses of logs: what stands before `://`.

/// Schemes that are understood: S3 and what speaks like it, Google's, Azure's, and any server of HTTP.
const SCHEMES: &[&str] = &["s3", "s3a", "gs", "az", "azure", "abfs", "abfss", "http", "https"];

/// Whether this is an address rather than a path.
pub fn is_address(name: &str) -> bool {
    name.split_once("://").is_some_and(|(scheme, _)| SCHEMES.contains(&scheme))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_no_addresses() {
        assert!(["s3://a/b.ulg", "https://a/b", "az://c/"].into_iter().all(is_address));
        assert!(
            ["a.ulg", "/s3/a", "s3:/a", "c:\\a", "file://a", "-", "weird://x", "://"]
                .into_iter()
                .all(|n| !is_address(n))
        );
    }
}
