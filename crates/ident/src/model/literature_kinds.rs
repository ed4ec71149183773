//! Structures of the thesis as rows of the table of model kinds: no keys, the user's channel names.

use std::sync::Arc;

use dynocal_numerics::registry::{self, MemberDoc};
use serde::Deserialize;

use super::form::Form;
use super::kinds::{ModelKind, Structure};
use super::literature::{self, LiteratureModel};
use super::poly::{PolyNarx, StructureError, spec::FORM};
use crate::experiment::Experiment;

/// One row.
macro_rules! literature_kind {
    ($row:ident, $name:literal, $what:literal, $model:expr) => {
        /// Row of the table.
        pub(super) const $row: ModelKind = ModelKind {
            doc: MemberDoc { name: $name, what: $what, params: &[] },
            form: &FORM,
            build: |keys| {
                registry::keys::<NoKeys>($name, keys)?;
                Ok(Box::new(Printed($model)))
            },
        };
    };
}

literature_kind!(
    TORQUE_7_8,
    "torque_7_8",
    "torque structure of eq. (7.8); inputs inj, spark, throttle, speed",
    literature::torque_7_8()
);
literature_kind!(
    LAMBDA_7_8,
    "lambda_7_8",
    "lambda structure of eq. (7.8); inputs inj, spark, throttle, speed",
    literature::lambda_7_8()
);
literature_kind!(
    TORQUE_4_17,
    "torque_4_17",
    "torque structure of eq. (4.17); inputs fuel pulse width, bleed valve, speed",
    literature::torque_4_17()
);
literature_kind!(
    LAMBDA_4_53,
    "lambda_4_53",
    "lambda structure of eq. (4.53); inputs fuel pulse width, bleed valve, speed",
    literature::lambda_4_53()
);
literature_kind!(
    TORQUE_5_3,
    "torque_5_3",
    "linear torque structure of eq. (5.3); inputs bleed valve, spark, speed",
    literature::torque_5_3()
);
literature_kind!(
    INVERSE_INJ_7_18,
    "inverse_inj_7_18",
    "injection from torque, lambda and speed, eq. (7.18)",
    {
        let [inj, _, _] = literature::inverse_7_18();
        inj
    }
);
literature_kind!(
    INVERSE_SPARK_7_18,
    "inverse_spark_7_18",
    "spark from torque, lambda and speed, eq. (7.18)",
    {
        let [_, spark, _] = literature::inverse_7_18();
        spark
    }
);
literature_kind!(
    INVERSE_THROTTLE_7_18,
    "inverse_throttle_7_18",
    "throttle from torque, lambda and speed, eq. (7.18)",
    {
        let [_, _, throttle] = literature::inverse_7_18();
        throttle
    }
);

/// Keys of a kind that has none.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoKeys {}

/// A structure of the thesis under the user's channel names.
struct Printed(LiteratureModel);

impl Structure for Printed {
    fn form(
        &self,
        inputs: &[String],
        output: &str,
        _data: &[Experiment],
    ) -> Result<Arc<dyn Form>, StructureError> {
        let regressors = self.0.model.regressors().to_vec();
        Ok(Arc::new(PolyNarx::new(inputs.to_vec(), output.into(), regressors)?))
    }
}
