// What is wrong, and what was, out of a status.

import { shown } from "./math.js";

export const duration = (s) => (s >= 90 ? `${Math.floor(s / 60)} min ${String(Math.floor(s % 60)).padStart(2, "0")} s` : `${shown(s, 1)} s`);

/// Sentences that stand, those that are over, and what to say above them: that nothing is wrong only
/// where nothing was.
export function told(status) {
  const times = (notice) => (notice.count > 1 ? `, ${notice.count} times` : "");
  const now = [];
  for (const notice of status.notices) {
    if (notice.until_s === null) now.push({ text: notice.sentence, isLoss: notice.is_loss, fine: `since ${duration(notice.since_s)} of running${times(notice)}` });
  }
  const more = [status.recording_fault, status.map_fault, status.other_service, status.link.warning, status.poses?.source?.first_fault, status.poses?.source?.missing];
  for (const text of more) if (text && !now.some((n) => n.text.includes(text))) now.push({ text, fine: "" });
  const over = status.notices.filter((notice) => notice.until_s !== null)
    .map((n) => ({ text: n.sentence, fine: `was so from ${duration(n.since_s)} to ${duration(n.until_s)} of running${times(n)}` }));
  const above = now.length ? "" : over.length ? "✓ all is well again; earlier in this run:" : "✓ nothing is wrong";
  return { now, over, above };
}
