//! What Cockpit, a ground station, asks an extension of `BlueOS`: a widget, and actions for buttons and joysticks.
//! Format: `ExtrasJsonSchema` of Cockpit 1.19 (`src/libs/blueos/schemas.ts`), and its documentation of external
//! integrations.

use serde_json::{Value, json};

/// Where it is asked for.
pub(crate) const PATH: &str = "/cockpit_extras.json";
/// What `BlueOS` makes of our name (letters and digits alone): under `/extensionv2/` it hands requests on to us.
const SANITIZED_NAME: &str = "echosplat";
/// Stands where the owner puts the token, in Cockpit's own list of actions.
const TOKEN: &str = "web.token of EchoSplat";

/// All that is offered.
pub(crate) fn extras(version: &str, has_actions: bool) -> Value {
    let actions = match has_actions {
        true => vec![
            recording("start", "EchoSplat: begin a recording"),
            recording("stop", "EchoSplat: end the recording"),
        ],
        false => Vec::new(),
    };
    json!({
        "targetSystem": "Cockpit",
        "targetCockpitApiVersion": "1.0.0",
        "widgets": [{
            "name": "EchoSplat map",
            "iframeUrl": "/widget.html",
            "iconUrl": "/icon.svg",
            "version": version,
            "useExtensionPathAsBaseUrl": true,
            // It fits any size by itself.
            "contentZoom": 1,
            "scaleContentWithWidget": false,
        }],
        "actions": actions,
    })
}

fn recording(act: &str, name: &str) -> Value {
    // Cockpit puts the vehicle's address there.
    let url =
        format!("http://{{{{ vehicle-address }}}}/extensionv2/{SANITIZED_NAME}/recording/{act}");
    json!({
        "id": format!("echosplat-recording-{act}"),
        "name": name,
        "type": "http-request",
        "config": {
            "name": name,
            "url": url,
            "method": "POST",
            "headers": { "X-EchoSplat-Token": TOKEN },
            "urlParams": {},
            "body": "",
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_offered_only_where_they_would_be_taken() {
        assert_eq!(extras("1", false)["actions"], json!([]));
        let all = extras("1", true);
        let urls: Vec<&str> = all["actions"]
            .as_array()
            .unwrap()
            .iter()
            .map(|action| action["config"]["url"].as_str().unwrap())
            .collect();
        assert_eq!(
            urls,
            [
                "http://{{ vehicle-address }}/extensionv2/echosplat/recording/start",
                "http://{{ vehicle-address }}/extensionv2/echosplat/recording/stop",
            ]
        );
    }
}
