//! When certificates expire: said before they do, for from then on nobody is let in.
//!
//! A process says it of the certificates that it uses: in its log, when it begins to use one and once a day; at `/metrics`, as the seconds that are
//! left; and to whoever asks here.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, Once, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;

const HOUR_S: i64 = 3600;
const DAY_S: i64 = 24 * HOUR_S;
/// Certificates are warned of when they expire within so many days. Those that `repose deploy` makes are good for a year, and a robot's may have to be
/// carried to it. The alerts in `deploy/prometheus` have the same number.
const WARNED_DAYS: i64 = 30;
/// How often a process says again what expires.
const SAID_EVERY: Duration = Duration::from_secs(24 * 3600);

/// When the certificates of a file expire.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct CertificateExpiry {
    /// The file.
    pub file: PathBuf,
    /// The date on which they do, in UTC, `2026-12-03`; of several the first.
    pub expires_on: String,
    /// The instant, seconds since the Unix epoch.
    pub expires_s: i64,
}

impl CertificateExpiry {
    /// Reads the certificates of a file, PEM.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn read(file: &Path) -> Result<Self, String> {
        let mut first: Option<Self> = None;
        for certificate in CertificateDer::pem_file_iter(file).map_err(|e| e.to_string())? {
            let certificate = certificate.map_err(|e| e.to_string())?;
            let (_rest, certificate) = x509_parser::parse_x509_certificate(&certificate).map_err(|e| e.to_string())?;
            let ends = certificate.validity().not_after;
            if first.as_ref().is_none_or(|first| ends.timestamp() < first.expires_s) {
                let expires_on = ends.to_datetime().date().to_string();
                first = Some(Self { file: file.to_owned(), expires_on, expires_s: ends.timestamp() });
            }
        }
        first.ok_or_else(|| "there is no certificate in it".to_owned())
    }

    /// The seconds until then, by this machine's clock; negative when it is past.
    pub fn left_s(&self) -> i64 {
        self.expires_s - now_s()
    }

    /// What is to be said of it now; nothing while there are more than 30 days left.
    pub fn warning(&self) -> Option<String> {
        self.warning_at(now_s())
    }

    fn warning_at(&self, now_s: i64) -> Option<String> {
        let (file, on, left_s) = (self.file.display(), &self.expires_on, self.expires_s - now_s);
        if left_s > WARNED_DAYS * DAY_S {
            return None;
        }
        Some(match left_s {
            ..=0 => format!("the certificate {file} has expired, on {on}"),
            _ if left_s < 2 * DAY_S => format!("the certificate {file} expires in {} h, on {on}", left_s / HOUR_S),
            _ => format!("the certificate {file} expires in {} days, on {on}", left_s / DAY_S),
        })
    }
}

fn now_s() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}

/// How a process goes by a file of certificates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CertificateReading {
    /// It reads it once: what the file holds later counts after a restart.
    Once,
    /// It reads it again whenever it needs one.
    Again,
}

/// A file of certificates in use.
struct Used {
    expiry: CertificateExpiry,
    reading: CertificateReading,
}

/// The files that this process uses, however many sessions and listeners it has.
fn used() -> MutexGuard<'static, BTreeMap<PathBuf, Used>> {
    static USED: Mutex<BTreeMap<PathBuf, Used>> = Mutex::new(BTreeMap::new());
    USED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// From now on this process uses the certificates of a file, and says when they are about to expire. A file that cannot be read is left to whoever
/// reads it for use.
pub fn watch_certificate(file: &Path, reading: CertificateReading) {
    let expiry = match CertificateExpiry::read(file) {
        Ok(expiry) => expiry,
        Err(why) => return tracing::debug!(file = %file.display(), why, "when it expires is not known"),
    };
    let before = used().insert(file.to_owned(), Used { expiry: expiry.clone(), reading });
    if before.is_none_or(|before| before.expiry != expiry) {
        say(&[expiry]);
    }
    static SAYS_DAILY: Once = Once::new();
    SAYS_DAILY.call_once(|| {
        if let Err(error) = std::thread::Builder::new().name("certificates".to_owned()).spawn(say_daily) {
            tracing::warn!(%error, "what expires later is not said");
        }
    });
}

/// Says what expires, for as long as the process runs.
fn say_daily() {
    loop {
        std::thread::sleep(SAID_EVERY);
        say(&certificates_in_use());
    }
}

/// When the certificates that this process uses expire, by their files.
pub fn certificates_in_use() -> Vec<CertificateExpiry> {
    let look = |used: &mut Used| {
        if used.reading == CertificateReading::Again
            && let Ok(expiry) = CertificateExpiry::read(&used.expiry.file)
        {
            used.expiry = expiry;
        }
        used.expiry.clone()
    };
    used().values_mut().map(look).collect()
}

/// Says in the log what is to be said.
pub(crate) fn say(expiries: &[CertificateExpiry]) {
    for warning in expiries.iter().filter_map(CertificateExpiry::warning) {
        tracing::warn!("{warning}");
    }
}

/// Tells the metric.
pub(crate) fn tell_metric() {
    for expiry in certificates_in_use() {
        let file = expiry.file.display().to_string();
        metrics::gauge!("repose_certificate_expires_in_seconds", "file" => file).set(expiry.left_s() as f64);
    }
}

#[cfg(test)]
mod tests {
    use rcgen::{CertificateParams, KeyPair, date_time_ymd};

    use super::*;

    /// A certificate that is good until the beginning of a day, as PEM.
    fn until(year: i32, month: u8, day: u8) -> String {
        let mut params = CertificateParams::new(vec!["localhost".to_owned()]).expect("a name");
        params.not_after = date_time_ymd(year, month, day);
        params.self_signed(&KeyPair::generate().expect("a key")).expect("signed").pem()
    }

    #[test]
    fn a_file_expires_with_the_first_of_its_certificates_and_is_warned_of_in_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("chain.pem");
        std::fs::write(&file, until(2040, 1, 1) + &until(2031, 3, 4) + &until(2035, 1, 1)).expect("written");
        let expiry = CertificateExpiry::read(&file).expect("three certificates");
        // The fourth of March 2031, midnight.
        assert_eq!((expiry.expires_on.as_str(), expiry.expires_s), ("2031-03-04", 1_930_348_800));
        let warning = |left_s: i64| expiry.warning_at(expiry.expires_s - left_s);
        let said = |left_s: i64, words: &str| warning(left_s).is_some_and(|w| w.contains(words) && w.contains("chain.pem"));
        assert_eq!(warning(30 * DAY_S + 1), None);
        assert!(said(30 * DAY_S, "expires in 30 days, on 2031-03-04"));
        assert!(said(2 * DAY_S, "expires in 2 days"));
        assert!(said(2 * DAY_S - 1, "expires in 47 h"));
        assert!(said(1, "expires in 0 h"));
        assert!(said(0, "has expired, on 2031-03-04"));
        assert!(said(-DAY_S, "has expired"));
    }

    #[test]
    fn a_file_that_is_read_again_counts_as_it_is_now_and_one_that_is_read_once_as_it_was() {
        let folder = tempfile::tempdir().expect("a folder");
        let [again, once] = ["again.pem", "once.pem"].map(|name| folder.path().join(name));
        for (file, reading) in [(&again, CertificateReading::Again), (&once, CertificateReading::Once)] {
            std::fs::write(file, until(2031, 3, 4)).expect("written");
            watch_certificate(file, reading);
            std::fs::write(file, until(2032, 5, 6)).expect("written");
        }
        let on = |file: &PathBuf| certificates_in_use().into_iter().find(|expiry| expiry.file == *file).map(|expiry| expiry.expires_on);
        assert_eq!([on(&again).as_deref(), on(&once).as_deref()], [Some("2032-05-06"), Some("2031-03-04")]);
        // Half of a file, as while it is written.
        std::fs::write(&again, "-----BEGIN CERTIFICATE-----").expect("written");
        assert_eq!(on(&again).as_deref(), Some("2032-05-06"));
    }

    #[test]
    fn a_file_without_a_certificate_is_said_to_have_none() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("key.pem");
        std::fs::write(&file, KeyPair::generate().expect("a key").serialize_pem()).expect("written");
        assert_eq!(CertificateExpiry::read(&file), Err("there is no certificate in it".to_owned()));
        assert!(CertificateExpiry::read(&folder.path().join("missing.pem")).is_err());
    }
}
