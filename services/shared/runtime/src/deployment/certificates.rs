//! Certificates for a trial: an authority of the deployment's own, and what it signs. An operator with an authority puts its certificates in
//! their place; what is there already is kept.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rcgen::{BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose};

use super::writer::{Failed, Files};

/// How long the authority is valid.
const AUTHORITY_DAYS: u64 = 10 * 365;
/// How long what it signs is valid.
const SIGNED_DAYS: u64 = 365;

/// The authority, to sign with.
pub(super) struct Authority {
    /// None where its key lies elsewhere.
    issuer: Option<Issuer<'static, KeyPair>>,
    key_file: PathBuf,
    /// Its certificate, which everyone trusts.
    pub(super) certificate: String,
}

impl Authority {
    /// The deployment's authority: the one in `folder`, or a new one.
    pub(super) fn of(files: &mut Files, folder: &Path) -> Result<Self, Failed> {
        let (certificate_file, key_file) = (folder.join("authority.pem"), folder.join("authority-key.pem"));
        if let Some(certificate) = files.existing(&certificate_file)? {
            let issuer = files.existing(&key_file)?.map(|key| {
                let key = KeyPair::from_pem(&key).map_err(|e| Failed::new(&key_file, e))?;
                Issuer::from_ca_cert_pem(&certificate, key).map_err(|e| Failed::new(&certificate_file, e))
            });
            return Ok(Self { issuer: issuer.transpose()?, key_file, certificate });
        }
        let fail = |e: rcgen::Error| Failed::new(&certificate_file, e);
        let mut params = params(Vec::new(), "Repose trial authority", AUTHORITY_DAYS).map_err(fail)?;
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let key = KeyPair::generate().map_err(fail)?;
        let certificate = params.self_signed(&key).map_err(fail)?.pem();
        files.write(&certificate_file, &certificate)?;
        files.write_secret(&key_file, &key.serialize_pem())?;
        Ok(Self { issuer: Some(Issuer::new(params, key)), key_file, certificate })
    }

    /// A certificate and its key at these files, unless they are there: the router's with its `hosts`, or a user's without.
    pub(super) fn sign(&self, files: &mut Files, certificate: &Path, key: &Path, name: &str, hosts: &[&str]) -> Result<(), Failed> {
        if files.existing(certificate)?.is_some() && files.existing(key)?.is_some() {
            return Ok(());
        }
        let Some(issuer) = &self.issuer else {
            let why = format!("is missing, and {} is to be signed with it: put either there", certificate.display());
            return Err(Failed::new(&self.key_file, why));
        };
        let fail = |e: rcgen::Error| Failed::new(certificate, e);
        let hosts = hosts.iter().map(|host| (*host).to_owned()).collect::<Vec<_>>();
        let usage = if hosts.is_empty() { ExtendedKeyUsagePurpose::ClientAuth } else { ExtendedKeyUsagePurpose::ServerAuth };
        let mut params = params(hosts, name, SIGNED_DAYS).map_err(fail)?;
        params.extended_key_usages = vec![usage];
        params.use_authority_key_identifier_extension = true;
        let pair = KeyPair::generate().map_err(fail)?;
        let signed = params.signed_by(&pair, issuer).map_err(fail)?;
        files.write(certificate, &signed.pem())?;
        files.write_secret(key, &pair.serialize_pem())
    }
}

fn params(hosts: Vec<String>, name: &str, days: u64) -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(hosts)?;
    params.distinguished_name.push(DnType::CommonName, name);
    let epoch = rcgen::date_time_ymd(1970, 1, 1);
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    // A clock that is a little behind takes it too.
    params.not_before = epoch + now.saturating_sub(Duration::from_secs(3600));
    params.not_after = epoch + now + Duration::from_secs(days * 24 * 3600);
    Ok(params)
}
