//! Who may ask for what.
//!
//! | rule | against |
//! |---|---|
//! | `Host` is an address or a name that nobody outside can make point here | pages that rebind their own name to this machine |
//! | a write, or the WebSocket, from a browser has this page's own `Origin` | pages of others that are open in the same browser |
//! | a write that reaches another address than loopback bears the token | other machines |
//!
//! With `web.cockpit_actions` a page of another origin may begin and end recordings, and nothing else, if it bears the
//! token: that a browser does not add by itself.

use std::net::IpAddr;

use axum::extract::Request;
use axum::http::header::{AUTHORIZATION, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode};

use crate::address::is_loopback;

/// Header that bears the token; `Authorization: Bearer` does too.
pub(crate) const TOKEN_HEADER: HeaderName = HeaderName::from_static("x-echosplat-token");
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// The rules of one server.
#[derive(Debug, Clone)]
pub(crate) struct Access {
    /// Only this machine reaches it.
    pub(crate) is_loopback: bool,
    /// Wanted of writes unless only this machine reaches it.
    pub(crate) token: String,
    /// More names under which it is asked for.
    pub(crate) allowed_hosts: Vec<String>,
    /// Whether pages of other origins may begin and end recordings with the token.
    pub(crate) cockpit_actions: bool,
}

/// What such a page may ask for.
const COCKPIT_ACTIONS: [&str; 2] = ["/recording/start", "/recording/stop"];

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub(crate) status: StatusCode,
    pub(crate) sentence: &'static str,
}

const STRANGE_HOST: Refusal = Refusal {
    status: StatusCode::FORBIDDEN,
    sentence: "this name is not one of this machine: ask by its address, or add the name to web.allowed_hosts",
};
const OTHER_ORIGIN: Refusal = Refusal {
    status: StatusCode::FORBIDDEN,
    sentence: "refused: the request comes from a page of another origin",
};
const NO_TOKEN: Refusal = Refusal {
    status: StatusCode::UNAUTHORIZED,
    sentence: "this needs the token that the service wrote into its log at the start, or web.token of its configuration",
};

impl Access {
    /// Every request.
    pub(crate) fn host(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let host = one(headers, &HOST).ok_or(STRANGE_HOST)?;
        match self.knows(host) {
            true => Ok(()),
            false => Err(STRANGE_HOST),
        }
    }

    fn knows(&self, authority: &str) -> bool {
        let name = host_of(authority);
        let named = |allowed: &String| {
            allowed.eq_ignore_ascii_case(name) || allowed.eq_ignore_ascii_case(authority)
        };
        if name.eq_ignore_ascii_case("localhost") || self.allowed_hosts.iter().any(named) {
            return true;
        }
        match name.parse::<IpAddr>() {
            Ok(ip) => !self.is_loopback || is_loopback(ip),
            // Names of the public DNS have a dot, and none of them ends so.
            Err(_) => !self.is_loopback && (!name.contains('.') || is_local_name(name)),
        }
    }

    /// Writes and the WebSocket: of a browser, from this page alone.
    pub(crate) fn origin(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        if let Some(site) = one(headers, &FETCH_SITE)
            && site != "same-origin"
            && site != "none"
        {
            return Err(OTHER_ORIGIN);
        }
        if !headers.contains_key(ORIGIN) {
            return Ok(());
        }
        let origin = one(headers, &ORIGIN).ok_or(OTHER_ORIGIN)?;
        let (scheme, authority) = origin.split_once("://").ok_or(OTHER_ORIGIN)?;
        let default_port = match scheme {
            "http" => ":80",
            "https" => ":443",
            _ => return Err(OTHER_ORIGIN),
        };
        let bare = |authority: &str| {
            let bare = authority.strip_suffix(default_port).unwrap_or(authority);
            bare.to_ascii_lowercase()
        };
        let host = one(headers, &HOST).ok_or(STRANGE_HOST)?;
        // A proxy may ask under another name than the browser, if it is told so.
        let named = |allowed: &String| bare(allowed) == bare(authority);
        match bare(authority) == bare(host) || self.allowed_hosts.iter().any(named) {
            true => Ok(()),
            false => Err(OTHER_ORIGIN),
        }
    }

    fn is_cockpit_action(&self, request: &Request) -> bool {
        self.cockpit_actions && COCKPIT_ACTIONS.contains(&request.uri().path())
    }

    /// Whether it is a browser's question if another page may send the token.
    pub(crate) fn lets_ask(&self, request: &Request) -> bool {
        request.method() == Method::OPTIONS && self.is_cockpit_action(request)
    }

    /// The origin of a page that may act because it bears the token, also where none is wanted; or that asks if it may.
    pub(crate) fn page_with_token(&self, request: &Request) -> Option<HeaderValue> {
        let bears = || is_same(given(request.headers()).as_bytes(), self.token.as_bytes());
        let may = self.is_cockpit_action(request) && (self.lets_ask(request) || bears());
        let origin = request.headers().get(ORIGIN).filter(|_| may)?;
        Some(origin.clone())
    }

    /// What changes anything, besides [`Access::origin`].
    pub(crate) fn token(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        if self.is_loopback {
            return Ok(());
        }
        match is_same(given(headers).as_bytes(), self.token.as_bytes()) {
            true => Ok(()),
            false => Err(NO_TOKEN),
        }
    }
}

/// The token that a request bears; empty without.
fn given(headers: &HeaderMap) -> &str {
    let bearer = one(headers, &AUTHORIZATION).and_then(|text| text.strip_prefix("Bearer "));
    one(headers, &TOKEN_HEADER).or(bearer).unwrap_or_default()
}

/// The header's text if it is there once.
fn one<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// Without the port and an address's brackets.
fn host_of(authority: &str) -> &str {
    if let Some(rest) = authority.strip_prefix('[') {
        return rest.split(']').next().unwrap_or(rest);
    }
    authority.split(':').next().unwrap_or(authority)
}

/// Of multicast DNS, which only the own network answers.
fn is_local_name(name: &str) -> bool {
    name.trim_end_matches('.')
        .to_ascii_lowercase()
        .ends_with(".local")
}

/// Takes as long whatever differs.
fn is_same(given: &[u8], wanted: &[u8]) -> bool {
    let differs = given
        .iter()
        .zip(wanted)
        .fold(0, |sum, (a, b)| sum | (a ^ b));
    !wanted.is_empty() && given.len() == wanted.len() && differs == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    fn access(is_loopback: bool) -> Access {
        Access {
            is_loopback,
            token: "a good token".to_owned(),
            allowed_hosts: vec!["rov.example".to_owned()],
            cockpit_actions: false,
        }
    }

    #[test]
    fn another_page_acts_only_where_that_is_allowed_with_the_token_and_on_recordings_alone() {
        let asked = |allowed: bool, method: &str, path: &str, token: &str| {
            let access = Access {
                cockpit_actions: allowed,
                ..access(false)
            };
            let request = Request::builder()
                .method(method)
                .uri(path)
                .header(ORIGIN, "http://cockpit.example")
                .header(&TOKEN_HEADER, token);
            let request = request.body(axum::body::Body::empty()).unwrap();
            (
                access.lets_ask(&request),
                access.page_with_token(&request).is_some(),
            )
        };
        let (start, good) = ("/recording/start", "a good token");
        assert_eq!(asked(true, "POST", start, good), (false, true));
        assert_eq!(asked(true, "POST", "/recording/stop", good), (false, true));
        assert_eq!(asked(true, "OPTIONS", start, ""), (true, true));
        for (allowed, method, path, token) in [
            (false, "POST", start, good),
            (false, "OPTIONS", start, ""),
            (true, "POST", start, "a wrong token"),
            (true, "POST", start, ""),
            (true, "POST", "/replay/pause", good),
            (true, "OPTIONS", "/replay/pause", ""),
        ] {
            let found = asked(allowed, method, path, token);
            assert_eq!(found, (false, false), "{allowed} {method} {path} {token}");
        }
    }

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, HeaderValue::from_static(value));
        }
        headers
    }

    fn is_known(is_loopback: bool, host: &'static str) -> bool {
        let headers = headers(&[("host", host)]);
        access(is_loopback).host(&headers).is_ok()
    }

    #[test]
    fn on_loopback_only_its_own_names_are_known() {
        for host in [
            "localhost",
            "LocalHost:8080",
            "127.0.0.1:8080",
            "[::1]:8080",
            "rov.example:8080",
        ] {
            assert!(is_known(true, host), "{host}");
        }
        for host in [
            "evil.example",
            "192.168.2.2:8080",
            "127.0.0.1.evil.example",
            "blueos.local",
            "",
        ] {
            assert!(!is_known(true, host), "{host}");
        }
    }

    #[test]
    fn elsewhere_names_of_the_public_dns_are_not() {
        for host in ["192.168.2.2:8080", "blueos.local", "rov", "[fe80::1]"] {
            assert!(is_known(false, host), "{host}");
        }
        for host in ["evil.example:8080", "local.evil.example"] {
            assert!(!is_known(false, host), "{host}");
        }
        let twice = headers(&[("host", "localhost"), ("host", "localhost")]);
        assert!(access(false).host(&twice).is_err());
        assert!(access(false).host(&HeaderMap::new()).is_err());
    }

    #[test]
    fn only_this_page_writes_from_a_browser() {
        let check = |pairs: &[(&'static str, &'static str)]| {
            let mut all = vec![("host", "127.0.0.1:8080")];
            all.extend(pairs);
            access(true).origin(&headers(&all)).is_ok()
        };
        assert!(check(&[]), "no browser");
        assert!(check(&[("origin", "http://127.0.0.1:8080")]));
        assert!(check(&[("sec-fetch-site", "same-origin")]));
        assert!(check(&[("origin", "https://rov.example")]), "by a proxy");
        for origin in [
            "http://evil.example",
            "http://127.0.0.1:9090",
            "http://127.0.0.1",
            "null",
            "file://127.0.0.1:8080",
            "",
        ] {
            assert!(!check(&[("origin", origin)]), "{origin}");
        }
        assert!(!check(&[("sec-fetch-site", "cross-site")]));
        assert!(!check(&[("sec-fetch-site", "same-site")]));
    }

    #[test]
    fn default_ports_may_be_left_out() {
        let all = headers(&[("host", "rov.local"), ("origin", "http://ROV.local:80")]);
        assert_eq!(access(false).origin(&all), Ok(()));
    }

    #[test]
    fn writes_from_other_machines_need_the_token() {
        assert_eq!(access(true).token(&HeaderMap::new()), Ok(()));
        let away = access(false);
        assert_eq!(away.token(&HeaderMap::new()), Err(NO_TOKEN));
        for wrong in ["", "a good toke", "a good token ", "A good token"] {
            let mut headers = HeaderMap::new();
            headers.append(TOKEN_HEADER, HeaderValue::from_static(wrong));
            assert_eq!(away.token(&headers), Err(NO_TOKEN), "{wrong}");
        }
        for (name, value) in [
            ("x-echosplat-token", "a good token"),
            ("authorization", "Bearer a good token"),
        ] {
            assert_eq!(away.token(&headers(&[(name, value)])), Ok(()));
        }
    }
}
