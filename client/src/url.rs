//! A server's address.

use crate::error::ClientError;

/// Where a server listens: `http://HOST[:PORT]`, port 80 if none is named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerUrl {
    host: String,
    port: u16,
}

impl ServerUrl {
    /// Reads an address; a missing `http://` is added, one slash at the end is allowed.
    ///
    /// Errors: [`ClientError::BadUrl`] for another scheme, a path, a user name, an empty host or a port that is none.
    pub fn parse(url: &str) -> Result<Self, ClientError> {
        let bad = |why| ClientError::BadUrl {
            url: url.chars().take(200).collect(),
            why,
        };
        let rest = match url.split_once("://") {
            Some((scheme, rest)) if scheme.eq_ignore_ascii_case("http") || scheme.eq_ignore_ascii_case("ws") => rest,
            Some(("https" | "wss", _)) => return Err(bad("this client has no TLS")),
            Some(_) => return Err(bad("only http is known")),
            None => url,
        };
        let authority = rest.strip_suffix('/').unwrap_or(rest);
        if authority.contains(['/', '?', '#', '@']) {
            return Err(bad("only a host and a port are wanted"));
        }
        if authority.contains(|c: char| c.is_whitespace() || c.is_control()) {
            return Err(bad("it holds a blank or a control character"));
        }
        // The colons of an IPv6 address stand within brackets.
        let (host, port) = match authority.rfind(':') {
            Some(colon) if !authority[colon..].contains(']') => (&authority[..colon], Some(&authority[colon + 1..])),
            _ => (authority, None),
        };
        let unbracketed = host
            .strip_prefix('[')
            .map_or(Some(host), |inner| inner.strip_suffix(']'));
        let host = unbracketed.ok_or_else(|| bad("a bracket is not closed"))?;
        if host.is_empty() {
            return Err(bad("the host is missing"));
        }
        let port = match port {
            None => 80,
            Some(text) => text
                .parse()
                .ok()
                .filter(|&p| p != 0)
                .ok_or_else(|| bad("the port is no number from 1 to 65535"))?,
        };
        Ok(Self {
            host: host.to_owned(),
            port,
        })
    }

    /// Host and port as they stand in a URL.
    pub fn authority(&self) -> String {
        if self.host.contains(':') {
            format!("[{}]:{}", self.host, self.port)
        } else {
            format!("{}:{}", self.host, self.port)
        }
    }

    /// Host without brackets, and port.
    pub(crate) fn socket_address(&self) -> (&str, u16) {
        (&self.host, self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        for (text, authority) in [
            ("http://127.0.0.1:8080", "127.0.0.1:8080"),
            ("http://sky.example/", "sky.example:80"),
            ("sky.example:9", "sky.example:9"),
            ("HTTP://[::1]:8080/", "[::1]:8080"),
            ("ws://[::1]", "[::1]:80"),
        ] {
            assert_eq!(
                ServerUrl::parse(text).map(|u| u.authority()).map_err(|e| e.to_string()),
                Ok(authority.to_owned())
            );
        }
    }

    #[test]
    fn what_is_no_address_is_refused() {
        for text in [
            "",
            "http://",
            "https://a",
            "ftp://a",
            "http://a:0",
            "http://a:70000",
            "http://a:x",
            "http://a/b",
            "http://u@a",
            "http://[::1",
            "a b",
        ] {
            assert!(
                matches!(ServerUrl::parse(text), Err(ClientError::BadUrl { .. })),
                "{text:?} was taken"
            );
        }
    }
}
