//! W3C trace context: what a call's attachment carries of the trace that it belongs to.
//!
//! With the feature `otlp`, spans go to a collector and a call's span continues its caller's. Without it the caller's context is passed on as it
//! came, so that a trace is not cut where one process of several was built without.

use tracing::Span;

/// Puts a span under the caller's, where the call carried one.
#[cfg(feature = "otlp")]
pub(crate) fn continue_from(span: &Span, traceparent: Option<&str>) {
    use opentelemetry::propagation::TextMapPropagator;
    use tracing_opentelemetry::OpenTelemetrySpanExt;
    let Some(traceparent) = traceparent else { return };
    let carrier = std::collections::HashMap::from([("traceparent".to_owned(), traceparent.to_owned())]);
    let context = opentelemetry_sdk::propagation::TraceContextPropagator::new().extract(&carrier);
    if let Err(error) = span.set_parent(context) {
        tracing::debug!(%error, "a span could not be put under its caller's");
    }
}

/// Puts a span under the caller's: nothing to do where spans go nowhere.
#[cfg(not(feature = "otlp"))]
pub(crate) fn continue_from(_span: &Span, _traceparent: Option<&str>) {}

/// The trace context of a span, to send along with calls made in it.
#[cfg(feature = "otlp")]
pub(crate) fn traceparent(span: &Span) -> Option<String> {
    use opentelemetry::propagation::TextMapPropagator;
    use tracing_opentelemetry::OpenTelemetrySpanExt;
    let mut carrier = std::collections::HashMap::new();
    opentelemetry_sdk::propagation::TraceContextPropagator::new().inject_context(&span.context(), &mut carrier);
    carrier.remove("traceparent")
}

/// The trace context of a span: none where spans go nowhere.
#[cfg(not(feature = "otlp"))]
pub(crate) fn traceparent(_span: &Span) -> Option<String> {
    None
}
