// How long something may have said nothing before what is shown of it is not called live.

/** A picture, a robot's state or an answer that is older than this, milliseconds. */
export const STALE_MS = 3000;

/** Whether what was last heard at an instant (of `performance.now()`) is out of date; what was never heard is not. */
export const isStale = (at, afterMs = STALE_MS) => at !== undefined && performance.now() - at > afterMs;

/** When the console was told of what it tells (an instant of `performance.now()`): what lay there before this page came says how old it is. */
export const instantOf = ({ age_ms: age }) => performance.now() - Number(age ?? 0);
