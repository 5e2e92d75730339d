//! Certificates for a trial: an authority of the deployment's own, and what it signs. An operator with an authority puts its certificates in
//! their place; what is there already is kept.
//!
//! A key is written before its certificate. Where that is as far as it comes, as on a full disk, the certificate is missing, and the next time both
//! are made anew: a pair that is there belongs together.

use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rcgen::{BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose};
use rustls::client::verify_server_name;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::server::ParsedCertificate;
use x509_parser::extensions::GeneralName;

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
        files.write_secret(&key_file, &key.serialize_pem())?;
        files.write(&certificate_file, &certificate)?;
        Ok(Self { issuer: Some(Issuer::new(params, key)), key_file, certificate })
    }

    /// A certificate and its key at these files, unless they are there: the router's with its `hosts`, or a user's without. A router's that is there
    /// must be for `name`, one of its hosts.
    pub(super) fn sign(&self, files: &mut Files, certificate: &Path, key: &Path, name: &str, hosts: &[&str]) -> Result<(), Failed> {
        if let (Some(there), Some(_)) = (files.existing(certificate)?, files.existing(key)?) {
            return if hosts.is_empty() { Ok(()) } else { check_host(certificate, &there, name) };
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
        // One whose key was missing does not stay beside the new key.
        files.remove(certificate)?;
        files.write_secret(key, &pair.serialize_pem())?;
        files.write(certificate, &signed.pem())
    }
}

/// Refuses a router's certificate that is not for `host`, by the rule by which users' links would.
pub(super) fn check_host(file: &Path, pem: &str, host: &str) -> Result<(), Failed> {
    let certificate = CertificateDer::from_pem_slice(pem.as_bytes()).map_err(|e| Failed::new(file, e))?;
    let parsed = ParsedCertificate::try_from(&certificate).map_err(|e| Failed::new(file, e))?;
    let name = ServerName::try_from(host).map_err(|e| Failed::new(file, format!("{host}: {e}")))?;
    verify_server_name(&parsed, &name).map_err(|_| {
        let named = names_of(&certificate);
        let named = if named.is_empty() { "no host".to_owned() } else { named.join(", ") };
        Failed::new(file, format!("is for {named}, not for {host}: delete it and run `repose deploy` again, or put your own"))
    })
}

/// The hosts that a certificate is for.
fn names_of(certificate: &[u8]) -> Vec<String> {
    let Ok((_rest, certificate)) = x509_parser::parse_x509_certificate(certificate) else { return Vec::new() };
    let Ok(Some(names)) = certificate.subject_alternative_name() else { return Vec::new() };
    let host = |name: &GeneralName<'_>| match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => address_of(bytes).map(|address| address.to_string()),
        _ => None,
    };
    names.value.general_names.iter().filter_map(host).collect()
}

/// An address of version 4 or 6, by its bytes.
fn address_of(bytes: &[u8]) -> Option<IpAddr> {
    let four = <[u8; 4]>::try_from(bytes).map(IpAddr::from);
    four.or_else(|_| <[u8; 16]>::try_from(bytes).map(IpAddr::from)).ok()
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
